"""Sample types: one class per kind of sensor reading, independent of the file or link.

Timestamps `t_us` are microseconds on the vehicle's clock.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

Vector = NDArray[np.float64]

IMU_VALUE_LIMIT = 1e6  # rad/s, m/s^2: above every IMU's range, and sums of squares cannot overflow


@dataclass(frozen=True, slots=True)
class ImuSample:
    """Angular rates (3,) in rad/s and specific force (3,) in m/s^2, body axes (FRD)."""

    t_us: int
    gyro_b_rps: Vector
    accel_b_mps2: Vector
    id: int = 0


@dataclass(frozen=True, slots=True)
class MagSample:
    """Magnetic field (3,) in gauss, body axes."""

    t_us: int
    field_b_gauss: Vector


@dataclass(frozen=True, slots=True)
class BaroSample:
    """Static pressure and the altitude that the sender derived from it."""

    t_us: int
    pressure_pa: float
    pressure_alt_m: float


@dataclass(frozen=True, slots=True)
class AirspeedSample:
    """Differential pressure."""

    t_us: int
    diff_pressure_pa: float


@dataclass(frozen=True, slots=True)
class GpsFix:
    """A GNSS receiver's position and velocity; the altitude is above mean sea level.

    `v_ned_mps` is None without a velocity; its last element is NaN where only ground speed and
    course are known (GPS_RAW_INT). `source` is the name of the message.
    """

    t_us: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    v_ned_mps: Vector | None
    fix_type: int
    satellites: int
    eph_m: float
    epv_m: float
    source: str


@dataclass(frozen=True, slots=True)
class Epoch:
    """Pseudoranges of one receiver epoch, one signal per satellite; arrays have shape (n,).

    `week` and `tow_s` are GPS time by the receiver's clock; `doppler_mps` is the range rate (NaN
    where there is none); satellites are named `G12`, `E05`, `R07`, `C21`. `carrier_hz` is the
    carrier frequency of each range and never changes for a satellite; None: all on L1 or E1.
    `signals` are RINEX signal codes (`1C`); empty if unknown. `second` are the ranges of the same
    satellites on a second frequency, NaN where there is none; `is_free` says that the ranges are
    the ionosphere-free combinations of both.
    """

    t_us: int
    week: int
    tow_s: float
    satellites: tuple[str, ...]
    pseudorange_m: Vector
    doppler_mps: Vector
    cn0_dbhz: Vector
    carrier_hz: Vector | None = None
    signals: tuple[str, ...] = ()
    second: "Epoch | None" = None
    is_free: bool = False

    def select(self, keep: Sequence[int]) -> "Epoch":
        """The epoch restricted to the satellites with the indices `keep`."""
        at = list(keep)
        return replace(
            self,
            satellites=tuple(self.satellites[i] for i in at),
            pseudorange_m=self.pseudorange_m[at],
            doppler_mps=self.doppler_mps[at],
            cn0_dbhz=self.cn0_dbhz[at],
            carrier_hz=None if self.carrier_hz is None else self.carrier_hz[at],
            signals=tuple(self.signals[i] for i in at) if self.signals else (),
            second=None if self.second is None else self.second.select(at),
        )


@dataclass(frozen=True, slots=True)
class StateVector:
    """The broadcast orbit of one GLONASS satellite at `toe_s` of GPS week `week`.

    Position, velocity and luni-solar acceleration (3,) in PZ-90, in m and s; the clock offset
    (minus tau_n) in s and its rate gamma_n; `health` is 0 for a healthy satellite.
    """

    satellite: str
    week: int
    toe_s: float
    r_m: tuple[float, float, float]
    v_mps: tuple[float, float, float]
    a_mps2: tuple[float, float, float]
    af0_s: float
    af1: float
    health: int = 0

    @property
    def fit_half_s(self) -> float:
        """Half the validity interval around `toe_s`: twice the upload interval, as in RTKLIB."""
        return 1800.0


@dataclass(frozen=True)
class PreciseOrbit:
    """A satellite's orbit and clock about `toe_s` of GPS week `week`, computed afterwards.

    The ECEF position in m is a polynomial of the seconds since then: five terms of three
    components. The clock offset in s and its rate include relativity, but not the group delay.
    """

    satellite: str
    week: int
    toe_s: float
    terms: tuple[float, ...]
    af0_s: float
    af1: float
    group_delay_s: float
    health: ClassVar[int] = 0
    fit_half_s: ClassVar[float] = 150.0


Orbit = Ephemeris | StateVector | PreciseOrbit


@dataclass(frozen=True, slots=True)
class EphemerisSample:
    """A satellite's orbit and clock."""

    t_us: int
    ephemeris: Orbit


@dataclass(frozen=True, slots=True)
class IonosphereSample:
    """Broadcast Klobuchar coefficients: four for the amplitude, four for the period."""

    t_us: int
    alpha: tuple[float, float, float, float]
    beta: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class RangeSample:
    """Distance to the ground along the body's down axis."""

    t_us: int
    distance_m: float


@dataclass(frozen=True, slots=True)
class VisionSample:
    """Local NED position, velocity where given, and attitude from vision or odometry."""

    t_us: int
    r_ned_m: Vector
    v_ned_mps: Vector | None
    q_nb: Vector


@dataclass(frozen=True, slots=True)
class TruthSample:
    """HIL_STATE_QUATERNION: true attitude, position and velocity of the simulated vehicle."""

    t_us: int
    q_nb: Vector
    omega_b_rps: Vector
    lat_deg: float
    lon_deg: float
    alt_m: float
    v_ned_mps: Vector


@dataclass(frozen=True, slots=True)
class AttitudeSample:
    """An autopilot's own attitude estimate (ATTITUDE or ATTITUDE_QUATERNION)."""

    t_us: int
    q_nb: Vector
    system: int
    source: str


@dataclass(frozen=True, slots=True)
class CommandSample:
    """The first 12 actuator outputs of an autopilot; 0 where an output does not exist.

    HIL_ACTUATOR_CONTROLS ranges from -1 to 1; `OUTPUTS` are in thousands of the raw output value
    (pulse widths in ms, or thousands of steps of a digital protocol).
    """

    t_us: int
    outputs: Vector
    source: str = "HIL_ACTUATOR_CONTROLS"


@dataclass(frozen=True, slots=True)
class SpareSample:
    """A reading of a redundant sensor; only the voting test of its kind uses it.

    `kind` is that of the block, `instance` counts from 1; `numbers` (up to 6,) are rates in rad/s
    and specific force in m/s^2, the field in gauss, the pressure in Pa, or latitude and longitude
    in degrees and altitude in m.
    """

    t_us: int
    kind: int
    instance: int
    numbers: Vector


Sample = (
    ImuSample
    | MagSample
    | BaroSample
    | AirspeedSample
    | GpsFix
    | Epoch
    | EphemerisSample
    | IonosphereSample
    | RangeSample
    | VisionSample
    | TruthSample
    | AttitudeSample
    | CommandSample
    | SpareSample
)
