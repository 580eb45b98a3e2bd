"""Pitot tube: the differential pressure of the airspeed."""

from typing import ClassVar

import numpy as np

from simvehicle.sensors.error_model import NoiseModel, NoiseState
from simvehicle.sensors.readings import AirspeedReading
from simvehicle.sensors.sensor import SensorParameters
from simvehicle.vehicles.body import Truth


class Airspeed(SensorParameters, frozen=True, kw_only=True):
    """Measures rho/2 Va^2 [Pa], with Va the total airspeed as in Beard and McLain, section 7.4."""

    channels: ClassVar = {"noise": 1}

    rate_hz: float = 50.0
    noise: NoiseModel = NoiseModel()

    def new_state(self, rng: np.random.Generator) -> NoiseState:
        """Draw the constant error."""
        return self.noise.new_state(rng, 1, self.rate_hz)

    def sample(
        self, truth: Truth, state: NoiseState, rng: np.random.Generator
    ) -> tuple[AirspeedReading, NoiseState]:
        """One reading."""
        error, state = self.noise.next(state, rng, self.rate_hz)
        u, v, w = truth.v_air_b_mps.tolist()
        pressure = 0.5 * truth.density_kgpm3 * (u * u + v * v + w * w)
        pressure = (1.0 + self.noise.scale) * pressure + error[0]
        return AirspeedReading(truth.t_us, pressure), state
