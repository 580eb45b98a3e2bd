"""Downward range finder, along the body z axis."""

from typing import ClassVar

from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.readings import RangeReading
from simvehicle.sensors.sensor import Rate, SensorParameters
from simvehicle.vehicles.body import Truth


def slant_range(truth: Truth) -> float:
    """Distance [m] to level ground along the body z axis; infinite if it points to the sky."""
    _, x, y, _ = truth.q_nb.tolist()
    down = 1.0 - 2.0 * (x * x + y * y)  # cosine between the body z axis and the vertical
    # Beyond 89.4 degrees of tilt the beam counts as horizontal.
    return max(truth.height_agl_m, 0.0) / down if down > 0.01 else float("inf")


class RangeSensor(SensorParameters, frozen=True, kw_only=True):
    """A sensor that measures distances of the ground within limits [m]."""

    rate_hz: Rate = 20.0
    min_m: float = 0.1
    max_m: float = 40.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.min_m < self.max_m:
            raise ValueError(
                f"min_m = {self.min_m}, max_m = {self.max_m} is not a range; use 0 <= min_m < max_m"
            )


class Rangefinder(RangeSensor, frozen=True, kw_only=True):
    """Measures the slant range [m], clamped to its limits."""

    channels: ClassVar = {"noise": 1}

    noise: NoiseModel = NoiseModel()

    def measure(self, truth: Truth, *errors: list[float]) -> RangeReading:
        """One reading."""
        distance = (1.0 + self.noise.scale) * slant_range(truth) + errors[0][0]
        # Clamped, as drivers do; estimators compare with the limits in the message.
        distance = min(self.max_m, max(self.min_m, distance))
        return RangeReading(truth.t_us, distance, self.min_m, self.max_m, self.id)
