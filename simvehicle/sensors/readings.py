"""The readings of the sensors: one frozen type per kind, in SI units and with a timestamp.

Those of the compiled sensors are in their records (`flight_record`).

Structs of plain floats, as they are created hundreds of times a second: creating a dataclass takes
ten times as long, and an array of three numbers longer than the measurement.
"""

import msgspec

from mavproxy_fault.numerics.arrays import Array

Triple = tuple[float, float, float]


# gc=False: readings have no references that could form a cycle.
class GpsReading(msgspec.Struct, frozen=True, gc=False):
    """A receiver's fix; `alt_m` is above mean sea level, `eph_m` and `epv_m` are one sigma."""

    t_us: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    v_ned_mps: Triple
    fix_type: int  # MAVLink's GPS_FIX_TYPE
    satellites: int
    eph_m: float
    epv_m: float
    id: int = 0


class PseudorangeReading(msgspec.Struct, frozen=True, gc=False):
    """Raw observations of one epoch on one signal per satellite, GPS L1 C/A or Galileo E1.

    `satellites` are names like `G12`; arrays have shape (n,). `tow_s` and `week` are GPS time on
    the receiver's clock. `doppler_mps` is the range rate (positive when the range grows).
    """

    t_us: int
    week: int
    tow_s: float
    satellites: tuple[str, ...]
    pseudorange_m: Array
    doppler_mps: Array
    cn0_dbhz: Array


class EphemerisReading(msgspec.Struct, frozen=True, gc=False):
    """A satellite's broadcast ephemeris as an RTCM 1019 or 1046 message."""

    t_us: int
    satellite: str
    rtcm: bytes


class RangeReading(msgspec.Struct, frozen=True, gc=False):
    """Distance along the sensor's axis (down unless mounted otherwise)."""

    t_us: int
    distance_m: float
    min_m: float
    max_m: float
    id: int = 0


class FlowReading(msgspec.Struct, frozen=True, gc=False):
    """Optical flow and gyro rates integrated over `integration_s` [rad]."""

    t_us: int
    integration_s: float
    flow_xy_rad: tuple[float, float]
    gyro_xyz_rad: Triple
    distance_m: float
    quality: int  # 0 is bad, 255 the best, as in MAVLink


class VisionReading(msgspec.Struct, frozen=True, gc=False):
    """Pose and velocity from vision in local NED; `q_nb` is (w, x, y, z).

    `odometry` selects ODOMETRY, with the velocity, or VISION_POSITION_ESTIMATE, the pose only.
    """

    t_us: int
    r_ned_m: Triple
    v_ned_mps: Triple
    q_nb: tuple[float, float, float, float]
    sigma_r_m: float
    sigma_v_mps: float
    odometry: bool = True


class BatteryReading(msgspec.Struct, frozen=True, gc=False):
    """Pack voltage, current and remaining charge (0 to 1)."""

    t_us: int
    voltage_v: float
    current_a: float
    remaining: float


class RemoteControlReading(msgspec.Struct, frozen=True, gc=False):
    """Pulse widths of a remote control's channels [us]."""

    t_us: int
    channels_us: tuple[int, ...]


Reading = (
    GpsReading
    | PseudorangeReading
    | EphemerisReading
    | RangeReading
    | FlowReading
    | VisionReading
    | BatteryReading
    | RemoteControlReading
)
