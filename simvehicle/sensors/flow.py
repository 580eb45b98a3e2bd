"""Optical flow of a downward camera (body z axis) over level ground.

Sign convention of MAVLink's OPTICAL_FLOW_RAD and HIL_OPTICAL_FLOW: the flow is the image rotation
about the body x and y axes as a gyro would measure it, so a pure rotation of the camera gives a
flow equal to the gyro's.
"""

from typing import ClassVar

from mavproxy_fault.numerics.rotations.one_rotation import rotate_to_body
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.rangefinder import RangeSensor, slant_range
from simvehicle.sensors.readings import FlowReading
from simvehicle.vehicles.body import Truth


class OpticalFlow(RangeSensor, frozen=True, kw_only=True):
    """Measures angular image motion, integrated over one sample period [rad]."""

    channels: ClassVar = {"flow": 2, "gyro": 3}

    flow: NoiseModel = NoiseModel()
    gyro: NoiseModel = NoiseModel()

    def measure(self, truth: Truth, *errors: list[float]) -> FlowReading:
        """One reading; quality is 0 if the ground is out of range."""
        # The flow board has its own gyro, with errors independent of the IMU's.
        (flow_x, flow_y), (gyro_x, gyro_y, gyro_z) = errors
        dt = 1.0 / self.rate_hz
        distance = slant_range(truth)
        p, q, r = truth.omega_b_rps.tolist()
        gain = 1.0 + self.gyro.scale
        gyro = (gain * p + gyro_x) * dt, (gain * q + gyro_y) * dt, (gain * r + gyro_z) * dt
        # MAVLink: a negative distance means unknown; quality is 0 (bad) to 255 (best).
        flow, shown, quality = (0.0, 0.0), -1.0, 0
        if self.min_m <= distance <= self.max_m:
            vx, vy, _ = rotate_to_body(truth.q_nb.tolist(), truth.v_ned_mps.tolist())
            gain = 1.0 + self.flow.scale
            # Moving forward (vx) shifts the image like pitching up (q), moving right (vy) like
            # rolling left.
            x, y = gain * (p - vy / distance), gain * (q + vx / distance)
            flow, shown, quality = ((x + flow_x) * dt, (y + flow_y) * dt), distance, 255
        return FlowReading(truth.t_us, dt, flow, gyro, shown, quality)
