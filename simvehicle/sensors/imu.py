"""Gyros and accelerometers: three axes each, sampled together."""

from typing import NamedTuple

import numpy as np

from simvehicle.body import Truth
from simvehicle.readings import ImuReading
from simvehicle.sensors.base import SensorParameters
from simvehicle.sensors.noise import Noise, NoiseState


class ImuState(NamedTuple):
    """Noise of the two triads."""

    gyro: NoiseState
    accel: NoiseState


class Imu(SensorParameters, frozen=True, kw_only=True):
    """Measures body rates [rad/s] and specific force [m/s^2], cut off at the ranges."""

    rate_hz: float = 250.0
    gyro: Noise = Noise()
    accel: Noise = Noise()
    gyro_range_rps: float = 35.0
    accel_range_mps2: float = 160.0

    def new_state(self, rng: np.random.Generator) -> ImuState:
        """Draw the constant errors."""
        return ImuState(
            self.gyro.new_state(rng, 3, self.rate_hz), self.accel.new_state(rng, 3, self.rate_hz)
        )

    def sample(
        self, truth: Truth, state: ImuState, rng: np.random.Generator
    ) -> tuple[ImuReading, ImuState]:
        """One reading."""
        gyro_error, gyro_state = self.gyro.next(state.gyro, rng, self.rate_hz)
        accel_error, accel_state = self.accel.next(state.accel, rng, self.rate_hz)
        gyro = (1.0 + self.gyro.scale) * truth.omega_b_rps + gyro_error
        accel = (1.0 + self.accel.scale) * truth.specific_force_b_mps2 + accel_error
        reach, limit = self.gyro_range_rps, self.accel_range_mps2
        reading = ImuReading(
            truth.t_us,
            np.minimum(np.maximum(gyro, -reach), reach),
            np.minimum(np.maximum(accel, -limit), limit),
            self.id,
        )
        return reading, ImuState(gyro_state, accel_state)
