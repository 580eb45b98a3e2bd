"""What the sensors say: one frozen type per kind, in SI units and stamped."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ImuReading:
    """Rates (3,) in rad/s and specific force (3,) in m/s^2, body axes forward-right-down."""

    t_us: int
    gyro_b_rps: Vector
    accel_b_mps2: Vector
    id: int = 0


@dataclass(frozen=True, slots=True)
class MagReading:
    """Magnetic flux density (3,) in gauss, body axes."""

    t_us: int
    field_b_gauss: Vector
    id: int = 0


@dataclass(frozen=True, slots=True)
class PressureReading:
    """Static pressure and air temperature."""

    t_us: int
    pressure_pa: float
    pressure_alt_m: float
    temperature_c: float
    id: int = 0


@dataclass(frozen=True, slots=True)
class AirspeedReading:
    """Differential pressure of the pitot tube."""

    t_us: int
    diff_pressure_pa: float


@dataclass(frozen=True, slots=True)
class GpsReading:
    """A receiver's solution; `alt_m` above mean sea level, `eph_m` and `epv_m` one sigma."""

    t_us: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    v_ned_mps: Vector
    fix_type: int
    satellites: int
    eph_m: float
    epv_m: float
    id: int = 0


@dataclass(frozen=True, slots=True)
class PseudorangeReading:
    """Raw observations of one epoch on one signal per satellite, GPS L1 C/A or Galileo E1.

    `satellites` are names like `G12`; arrays have shape (n,). `tow_s` and `week` are GPS time as
    the receiver's clock shows it. `doppler_mps` is the range rate (positive when the range grows).
    """

    t_us: int
    week: int
    tow_s: float
    satellites: tuple[str, ...]
    pseudorange_m: Vector
    doppler_mps: Vector
    cn0_dbhz: Vector


@dataclass(frozen=True, slots=True)
class EphemerisReading:
    """A satellite's broadcast ephemeris as an RTCM 1019 or 1046 message."""

    t_us: int
    satellite: str
    rtcm: bytes = field(repr=False)


@dataclass(frozen=True, slots=True)
class RangeReading:
    """Distance along the sensor's axis (down unless mounted otherwise)."""

    t_us: int
    distance_m: float
    min_m: float
    max_m: float
    id: int = 0


@dataclass(frozen=True, slots=True)
class FlowReading:
    """Optical flow integrated over `integration_s`, with the gyro's share, in rad."""

    t_us: int
    integration_s: float
    flow_xy_rad: Vector
    gyro_xyz_rad: Vector
    distance_m: float
    quality: int


@dataclass(frozen=True, slots=True)
class VisionReading:
    """Pose and velocity from vision in local NED; `q_nb` is (w, x, y, z)."""

    t_us: int
    r_ned_m: Vector
    v_ned_mps: Vector
    q_nb: Vector
    sigma_r_m: float
    sigma_v_mps: float


@dataclass(frozen=True, slots=True)
class BatteryReading:
    """Pack voltage, current and what is left (0 to 1)."""

    t_us: int
    voltage_v: float
    current_a: float
    remaining: float


Reading = (
    ImuReading
    | MagReading
    | PressureReading
    | AirspeedReading
    | GpsReading
    | PseudorangeReading
    | EphemerisReading
    | RangeReading
    | FlowReading
    | VisionReading
    | BatteryReading
)
