"""Absolute pressure and air temperature."""

from typing import ClassVar

import numpy as np

from simvehicle.environment.air import SEA_LEVEL_K, pressure_altitude
from simvehicle.sensors.error_model import NoiseModel, NoiseState
from simvehicle.sensors.readings import PressureReading
from simvehicle.sensors.sensor import SensorParameters
from simvehicle.vehicles.body import Truth

CELSIUS_ZERO_K = 273.15


class Barometer(SensorParameters, frozen=True, kw_only=True):
    """Measures static pressure [Pa]; the altitude is that of the standard atmosphere.

    It drifts with air temperature by `drift_pa_per_k`, relative to 15 degrees Celsius.
    """

    channels: ClassVar = {"noise": 1}

    rate_hz: float = 50.0
    noise: NoiseModel = NoiseModel()
    drift_pa_per_k: float = 0.0

    def new_state(self, rng: np.random.Generator) -> NoiseState:
        """Draw the constant error."""
        return self.noise.new_state(rng, 1, self.rate_hz)

    def sample(
        self, truth: Truth, state: NoiseState, rng: np.random.Generator
    ) -> tuple[PressureReading, NoiseState]:
        """One reading."""
        error, state = self.noise.next(state, rng, self.rate_hz)
        drift = self.drift_pa_per_k * (truth.temperature_k - SEA_LEVEL_K)
        pressure = (1.0 + self.noise.scale) * truth.pressure_pa + error[0] + drift
        # A large bias may make the pressure negative, where the altitude is undefined.
        altitude = pressure_altitude(max(pressure, 1.0))
        celsius = truth.temperature_k - CELSIUS_ZERO_K
        return PressureReading(truth.t_us, pressure, altitude, celsius, self.id), state
