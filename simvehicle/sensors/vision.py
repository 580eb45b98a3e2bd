"""Pose and velocity from visual odometry or motion capture."""

from typing import ClassVar, Literal

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.rotations.one_rotation import rotate_quaternion
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.readings import Triple, VisionReading
from simvehicle.sensors.sensor import Rate, SensorParameters
from simvehicle.vehicles.body import Truth


class Vision(SensorParameters, frozen=True, kw_only=True):
    """Measures position [m] and velocity [m/s] in local NED and attitude (errors in rad).

    A random walk of the position models visual odometry without loop closure. `message` selects the
    MAVLink message of a reading; VISION_POSITION_ESTIMATE has the pose only.
    """

    channels: ClassVar = {"position": 3, "velocity": 3, "attitude": 3}

    rate_hz: Rate = 30.0
    position: NoiseModel = NoiseModel()
    velocity: NoiseModel = NoiseModel()
    attitude: NoiseModel = NoiseModel()
    message: Literal["ODOMETRY", "VISION_POSITION_ESTIMATE"] = "ODOMETRY"

    def measure(self, truth: Truth, *errors: list[float]) -> VisionReading:
        """One reading."""
        # The attitude error is a small rotation in body axes, without scale.
        place, speed, tilt = errors
        return VisionReading(
            truth.t_us,
            _apply_errors(truth.r_ned_m, self.position.scale, place),
            _apply_errors(truth.v_ned_mps, self.velocity.scale, speed),
            rotate_quaternion(truth.q_nb.tolist(), tilt),
            # The reported sigma is never 0, as estimators need a variance.
            max(self.position.sigma, 0.01),
            max(self.velocity.sigma, 0.01),
            self.message == "ODOMETRY",
        )


def _apply_errors(true: Array, scale: float, error: list[float]) -> Triple:
    x, y, z = true.tolist()
    gain = 1.0 + scale
    return gain * x + error[0], gain * y + error[1], gain * z + error[2]
