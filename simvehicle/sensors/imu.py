"""The IMU: gyros and accelerometers of three axes each, sampled together."""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from simvehicle.sensors.error_model import NoiseModel, NoiseState
from simvehicle.sensors.readings import ImuReading, Triple
from simvehicle.sensors.sensor import SensorParameters
from simvehicle.vehicles.body import Truth


class ImuState(NamedTuple):
    """Noise of the two triads."""

    gyro: NoiseState
    accel: NoiseState


class ImuSensor(SensorParameters, frozen=True, kw_only=True):
    """Measures body rates [rad/s] and specific force [m/s^2], saturated at the ranges."""

    channels: ClassVar = {"gyro": 3, "accel": 3}

    rate_hz: float = 250.0
    gyro: NoiseModel = NoiseModel()
    accel: NoiseModel = NoiseModel()
    gyro_range_rps: float = 35.0  # 2000 deg/s and 16 g, the usual MEMS IMU settings of autopilots
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
            apply_triad_errors(
                truth.omega_b_rps.tolist(), self.gyro.scale, gyro_error, self.gyro_range_rps
            ),
            apply_triad_errors(
                truth.specific_force_b_mps2.tolist(),
                self.accel.scale,
                accel_error,
                self.accel_range_mps2,
            ),
            self.id,
        )
        # The states are mostly the same objects: avoid a new tuple per sample.
        if gyro_state is not state.gyro or accel_state is not state.accel:
            state = ImuState(gyro_state, accel_state)
        return reading, state


def apply_triad_errors(
    true: Sequence[float], scale: float, error: Sequence[float], limit: float
) -> Triple:
    """A triad with scale and error, saturated at its range; plain steps compile this function."""
    # Scalars: numpy on three numbers takes ten times as long.
    x, y, z = true
    a, b, c = error
    gain = 1.0 + scale
    x, y, z = gain * x + a, gain * y + b, gain * z + c
    # Values are almost always in range: one test covers three axes.
    if -limit <= min(x, y, z) and max(x, y, z) <= limit:
        return x, y, z
    x, y, z = max(-limit, x), max(-limit, y), max(-limit, z)
    return min(limit, x), min(limit, y), min(limit, z)
