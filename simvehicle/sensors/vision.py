"""Pose and velocity from visual odometry or motion capture."""

from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.rotations.one_rotation import rotate_quaternion
from simvehicle.sensors.error_model import NoiseModel, NoiseState
from simvehicle.sensors.readings import Triple, VisionReading
from simvehicle.sensors.sensor import SensorParameters
from simvehicle.vehicles.body import Truth


class VisionState(NamedTuple):
    """Noise of position, velocity and attitude."""

    position: NoiseState
    velocity: NoiseState
    attitude: NoiseState


class Vision(SensorParameters, frozen=True, kw_only=True):
    """Measures position [m] and velocity [m/s] in local NED and attitude (errors in rad).

    A random walk of the position models visual odometry without loop closure. `message` selects the
    MAVLink message of a reading; VISION_POSITION_ESTIMATE has the pose only.
    """

    channels: ClassVar = {"position": 3, "velocity": 3, "attitude": 3}

    rate_hz: float = 30.0
    position: NoiseModel = NoiseModel()
    velocity: NoiseModel = NoiseModel()
    attitude: NoiseModel = NoiseModel()
    message: Literal["ODOMETRY", "VISION_POSITION_ESTIMATE"] = "ODOMETRY"

    def new_state(self, rng: np.random.Generator) -> VisionState:
        """Draw the constant errors."""
        rate = self.rate_hz
        return VisionState(
            self.position.new_state(rng, 3, rate),
            self.velocity.new_state(rng, 3, rate),
            self.attitude.new_state(rng, 3, rate),
        )

    def sample(
        self, truth: Truth, state: VisionState, rng: np.random.Generator
    ) -> tuple[VisionReading, VisionState]:
        """One reading."""
        rate = self.rate_hz
        place, position = self.position.next(state.position, rng, rate)
        speed, velocity = self.velocity.next(state.velocity, rng, rate)
        # The attitude error is a small rotation in body axes, without scale.
        tilt, attitude = self.attitude.next(state.attitude, rng, rate)
        reading = VisionReading(
            truth.t_us,
            _apply_errors(truth.r_ned_m, self.position.scale, place),
            _apply_errors(truth.v_ned_mps, self.velocity.scale, speed),
            rotate_quaternion(truth.q_nb.tolist(), tilt),
            # The reported sigma is never 0, as estimators need a variance.
            max(self.position.sigma, 0.01),
            max(self.velocity.sigma, 0.01),
            self.message == "ODOMETRY",
        )
        return reading, VisionState(position, velocity, attitude)


def _apply_errors(true: NDArray[np.float64], scale: float, error: list[float]) -> Triple:
    x, y, z = true.tolist()
    gain = 1.0 + scale
    return gain * x + error[0], gain * y + error[1], gain * z + error[2]
