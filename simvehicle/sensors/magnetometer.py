"""Three-axis magnetometer."""

from typing import ClassVar

import numpy as np

from mavproxy_fault.numerics.rotations.one_rotation import rotate_to_body
from simvehicle.sensors.error_model import NoiseModel, NoiseState
from simvehicle.sensors.readings import MagReading
from simvehicle.sensors.sensor import SensorParameters
from simvehicle.vehicles.body import Truth


class Magnetometer(SensorParameters, frozen=True, kw_only=True):
    """Measures the Earth's field in body axes [gauss].

    `field_ned_gauss` is the field at home; over some kilometres it changes by less than the noise.
    By default the simulation fills in the value of the world magnetic model.
    """

    channels: ClassVar = {"noise": 3}

    rate_hz: float = 50.0
    noise: NoiseModel = NoiseModel()
    field_ned_gauss: tuple[float, float, float] | None = None

    def new_state(self, rng: np.random.Generator) -> NoiseState:
        """Draw the constant errors."""
        return self.noise.new_state(rng, 3, self.rate_hz)

    def sample(
        self, truth: Truth, state: NoiseState, rng: np.random.Generator
    ) -> tuple[MagReading, NoiseState]:
        """One reading."""
        # Filled in by the simulation.
        assert self.field_ned_gauss is not None
        error, state = self.noise.next(state, rng, self.rate_hz)
        x, y, z = rotate_to_body(truth.q_nb.tolist(), self.field_ned_gauss)
        a, b, c = error
        gain = 1.0 + self.noise.scale
        field = gain * x + a, gain * y + b, gain * z + c
        return MagReading(truth.t_us, field, self.id), state
