"""Downward range finder, along the body z axis."""

from typing import ClassVar

import numpy as np

from simvehicle.sensors.error_model import NoiseModel, NoiseState
from simvehicle.sensors.readings import RangeReading
from simvehicle.sensors.sensor import Rate, SensorParameters
from simvehicle.vehicles.body import Truth


def slant_range(truth: Truth) -> float:
    """Distance [m] to level ground along the body z axis; infinite if it points to the sky."""
    _, x, y, _ = truth.q_nb.tolist()
    down = 1.0 - 2.0 * (x * x + y * y)  # cosine between the body z axis and the vertical
    # Beyond 89.4 degrees of tilt the beam counts as horizontal.
    return max(truth.height_agl_m, 0.0) / down if down > 0.01 else float("inf")


def check_range_limits(min_m: float, max_m: float) -> None:
    """Refuse an empty measuring range."""
    if not 0.0 <= min_m < max_m:
        raise ValueError(f"min_m = {min_m}, max_m = {max_m} is not a range; use 0 <= min_m < max_m")


class Rangefinder(SensorParameters, frozen=True, kw_only=True):
    """Measures the slant range [m], clamped to its limits."""

    channels: ClassVar = {"noise": 1}

    rate_hz: Rate = 20.0
    noise: NoiseModel = NoiseModel()
    min_m: float = 0.1
    max_m: float = 40.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range_limits(self.min_m, self.max_m)

    def sample(
        self, truth: Truth, state: list[NoiseState], rng: np.random.Generator
    ) -> tuple[RangeReading, list[NoiseState]]:
        """One reading."""
        (error,), state = self.next_errors(state, rng)
        distance = (1.0 + self.noise.scale) * slant_range(truth) + error[0]
        # Clamped, as drivers do; estimators compare with the limits in the message.
        distance = min(self.max_m, max(self.min_m, distance))
        return RangeReading(truth.t_us, distance, self.min_m, self.max_m, self.id), state
