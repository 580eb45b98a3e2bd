"""Process noise of the filter: the IMU, the receiver's clock, and motion without an IMU."""

import msgspec

from mavproxy_fault.documents.document_check import NotNegative


class ProcessNoise(msgspec.Struct, frozen=True, kw_only=True):
    """Densities of the filter's process noise.

    Those of the IMU are for a small MEMS part, with a margin for vibration and timing.
    """

    gyro_rps: NotNegative = 2e-3  # rad/s/sqrt(Hz)
    accel_mps2: NotNegative = 2e-2  # m/s^2/sqrt(Hz)
    gyro_walk: NotNegative = 2e-5  # rad/s^2/sqrt(Hz)
    accel_walk: NotNegative = 5e-4  # m/s^3/sqrt(Hz)
    clock_m: NotNegative = 0.3  # m/sqrt(s)
    drift_mps: NotNegative = 0.3  # m/s/sqrt(s)
    isb_m: NotNegative = 0.005  # m/sqrt(s)
    motion_mps2: NotNegative = 3.0  # m/s^2/sqrt(Hz), where no IMU measures the motion
