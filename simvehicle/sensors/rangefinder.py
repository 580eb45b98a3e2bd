"""Range finder that looks down along the body's z axis."""

import numpy as np

from simvehicle.body import Truth
from simvehicle.readings import RangeReading
from simvehicle.sensors.base import SensorParameters
from simvehicle.sensors.noise import Noise, NoiseState


def slant_range(truth: Truth) -> float:
    """Distance [m] to level ground along the body's z axis; infinite when it points to the sky."""
    _, x, y, _ = truth.q_nb.tolist()
    down = 1.0 - 2.0 * (x * x + y * y)  # cosine between the body's z axis and the vertical
    return max(truth.height_agl_m, 0.0) / down if down > 0.01 else float("inf")


class Rangefinder(SensorParameters, frozen=True, kw_only=True):
    """Measures the slant range [m]; outside its limits it reports the farther one."""

    rate_hz: float = 20.0
    noise: Noise = Noise()
    min_m: float = 0.1
    max_m: float = 40.0

    def new_state(self, rng: np.random.Generator) -> NoiseState:
        """Draw the constant error."""
        return self.noise.new_state(rng, 1, self.rate_hz)

    def sample(
        self, truth: Truth, state: NoiseState, rng: np.random.Generator
    ) -> tuple[RangeReading, NoiseState]:
        """One reading."""
        error, state = self.noise.next(state, rng, self.rate_hz)
        distance = (1.0 + self.noise.scale) * slant_range(truth) + error[0]
        distance = min(self.max_m, max(self.min_m, distance))
        return RangeReading(truth.t_us, distance, self.min_m, self.max_m, self.id), state
