"""Gyros and accelerometers: three axes each, sampled together."""

from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simvehicle.sensors.error_model import Noise, NoiseState
from simvehicle.sensors.readings import ImuReading, Triple
from simvehicle.sensors.sensor import SensorParameters
from simvehicle.vehicles.body import Truth


class ImuState(NamedTuple):
    """Noise of the two triads."""

    gyro: NoiseState
    accel: NoiseState


class Imu(SensorParameters, frozen=True, kw_only=True):
    """Measures body rates [rad/s] and specific force [m/s^2], cut off at the ranges."""

    channels: ClassVar = {"gyro": 3, "accel": 3}

    rate_hz: float = 250.0
    gyro: Noise = Noise()
    accel: Noise = Noise()
    gyro_range_rps: float = 35.0  # 2000 deg/s, and 16 g: what MEMS units of autopilots are set to
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
        reading = ImuReading(
            truth.t_us,
            _measured(truth.omega_b_rps, self.gyro.scale, gyro_error, self.gyro_range_rps),
            _measured(
                truth.specific_force_b_mps2, self.accel.scale, accel_error, self.accel_range_mps2
            ),
            self.id,
        )
        # Mostly the states are the same objects, and a new tuple per sample would cost more.
        if gyro_state is not state.gyro or accel_state is not state.accel:
            state = ImuState(gyro_state, accel_state)
        return reading, state


def _measured(true: NDArray[np.float64], scale: float, error: list[float], limit: float) -> Triple:
    """A triad's values with scale and error, cut off at its range."""
    # Single floats: numpy on three numbers takes ten times as long.
    x, y, z = true.tolist()
    a, b, c = error
    gain = 1.0 + scale
    x, y, z = gain * x + a, gain * y + b, gain * z + c
    # Hardly ever out of range, so that one test stands for three.
    if -limit <= min(x, y, z) and max(x, y, z) <= limit:
        return x, y, z
    return _cut(x, limit), _cut(y, limit), _cut(z, limit)


def _cut(value: float, limit: float) -> float:
    return min(limit, max(-limit, value))
