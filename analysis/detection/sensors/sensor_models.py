"""Measurement models of the sensors, compiled: one function computes the innovation of each.

Each takes the numbers z (WIDTH,) of the newest sample (see `analysis.samples.block`), the filter's
view `at` (VIEW,) (see `sensor_kernel.filter_view`), the sensor's slow states b (3,) if they are
known, and one sigma of its noise. It fills in the rows of `out` (7, 3) for a test: the innovation v
(m,), its sensitivity h (m, k) to the slow states, and the rest r (m, m) of its variance; or the
first slow states (k,) as v and their covariance as r. It returns STARTED, TESTED or the number of a
reason why it cannot be tested, and m or k.

Numbers are in flat arrays because numba takes seconds to compile functions of many arguments.
"""

import math
from typing import NamedTuple

import numpy as np

from analysis.samples.block import FIX_3D, FIX_TYPE, FIX_VELOCITY
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3
from mavproxy_fault.numerics.earth_kernel import ecef_of

SEA_LEVEL_PA = 101_325.0  # ICAO standard atmosphere, Doc 7488
ISA_KELVIN, ISA_LAPSE, ISA_EXPONENT = 288.15, 6.5e-3, 5.25588
DENSITY_EXPONENT = 4.25588
LEAST_UPRIGHT = 0.7  # beyond 45 degrees off the vertical a beam may miss the terrain below
UNKNOWN_SLANT = 0.1  # of the distance: the error of an unknown tilt of up to 25 degrees, 1 - cos
SLOW_AIR_MPS = 6.0  # below it a pitot tube is inaccurate
WIND_MPS = 6.0  # one sigma of the unknown wind

MAG, BARO, AIRSPEED, RANGE, VISION, GPS_POSITION, GPS_VELOCITY = range(7)
SENSORS = ("mag", "baro", "airspeed", "range", "vision", "gps-position", "gps-velocity")
SLOW_STATES = (3, 1, 2, 1, 3, 3, 0)

NOTHING, STARTED, TESTED = 0, 1, 2
NO_ATTITUDE, NO_FIELD, NO_PRESSURE, NO_AIR_DATA, SLOW_AIR, NO_RANGE, TILTED = range(3, 10)
NO_POSITION, NO_FIX, NO_VELOCITY, NO_REFERENCE = range(10, 14)
REASONS = {
    NO_ATTITUDE: "attitude not known",
    NO_FIELD: "the field is not finite",
    NO_PRESSURE: "the pressure is not positive",
    NO_AIR_DATA: "the pressure is not finite",
    SLOW_AIR: f"airspeed below {SLOW_AIR_MPS:.0f} m/s",
    NO_RANGE: "the distance is not finite",
    TILTED: "tilted by more than 45 degrees",
    NO_POSITION: "the position is not finite",
    NO_FIX: "fix type {fix_type:.0f}",
    NO_VELOCITY: "no velocity",
    NO_REFERENCE: "no healthy reference",
}
# The view: position in ECEF, height, velocity NED, age of the sample in s, axes NED in ECEF,
# rotation body to NED (known or not), covariances of position, velocity, attitude; turn in rad/s.
R, HEIGHT, V_NED, LATE_S, AXES, ROT, UPRIGHT = 0, 3, 4, 7, 8, 17, 53
P_POSITION, P_VELOCITY, P_ATTITUDE, TURNING, VIEW = 26, 35, 44, 54, 55
V, H, S = 0, 1, 4  # rows of `out`


class SensorNoise(NamedTuple):
    """One sigma of each sensor, and the walk of its slow states (per square root of a second).

    `mag_gauss` is the disturbance of any magnetometer by currents and iron, `mag_quiet_gauss` what
    remains of one that proves to be better mounted. All are chosen for small autopilots' sensors.
    """

    baro_m: float = 1.0
    baro_walk_m: float = 0.05
    airspeed_mps: float = 1.0
    wind_walk_mps: float = 0.3
    mag_gauss: float = 0.03
    mag_quiet_gauss: float = 0.01
    field_walk_gauss: float = 2e-4
    vision_m: float = 0.5
    vision_walk_m: float = 0.1
    range_m: float = 0.5
    terrain_walk_m: float = 0.5
    gps_m: float = 1.5
    gps_walk_m: float = 0.1
    gps_mps: float = 0.4

    def sigmas(self) -> Vector:
        """One sigma of each sensor (s,)."""
        return np.array(
            [
                *(self.mag_gauss, self.baro_m, self.airspeed_mps, self.range_m),
                *(self.vision_m, self.gps_m, self.gps_mps),
            ]
        )

    def quiet(self) -> Vector:
        """One sigma of each sensor that proves to be at its best (s,)."""
        sigmas = self.sigmas()
        sigmas[MAG] = self.mag_quiet_gauss
        return sigmas

    def walks(self) -> Vector:
        """Variance per second of each sensor's slow states (s,)."""
        walks = (self.field_walk_gauss, self.baro_walk_m, self.wind_walk_mps, self.terrain_walk_m)
        return np.array([*walks, self.vision_walk_m, self.gps_walk_m, 0.0]) ** 2


@compiled
def pressure_altitude_m(pressure_pa: float) -> float:
    """Altitude in the standard atmosphere below 11 km."""
    ratio = math.pow(pressure_pa / SEA_LEVEL_PA, 1.0 / ISA_EXPONENT)
    return ISA_KELVIN / ISA_LAPSE * (1.0 - ratio)


@compiled
def density_kgpm3(altitude_m: float) -> float:
    """Density in the standard atmosphere below 11 km."""
    share = max(1.0 - ISA_LAPSE * altitude_m / ISA_KELVIN, 0.1)
    return SEA_LEVEL_DENSITY_KGPM3 * math.pow(share, DENSITY_EXPONENT)


@compiled
def _offset_innovation(out: Vector, b: Vector, known: bool, count: int) -> tuple[int, int]:
    """The innovation of a sensor of its own slow states: less these, or these initially."""
    if not known:
        return STARTED, count
    for i in range(count):
        out[V, i] -= b[i]
        out[H + i, i] = 1.0
    return TESTED, count


@compiled
def _finite(z: Vector) -> bool:
    """Whether the first three numbers are."""
    return bool(np.isfinite(z[0] + z[1] + z[2]))


@compiled
def mag_innovation(
    z: Vector, at: Vector, b: Vector, known: bool, sigma: float, out: Vector
) -> tuple[int, int]:
    """The field in NED is constant."""
    if at[UPRIGHT] == 0.0:
        return NO_ATTITUDE, 0
    if not _finite(z):
        return NO_FIELD, 0
    for i in range(3):
        for j in range(3):
            out[V, i] += at[ROT + 3 * i + j] * z[j]
    x, y, z_ = out[V, 0], out[V, 1], out[V, 2]
    # A small rotation moves the field by its cross product: the attitude's uncertainty.
    cross = np.array([0.0, -z_, y, z_, 0.0, -x, -y, x, 0.0])
    turned_sq = (at[LATE_S] * at[TURNING]) ** 2
    for i in range(3):
        for j in range(3):
            for k in range(9):
                part = cross[3 * i + k // 3] * at[P_ATTITUDE + k] * cross[3 * j + k % 3]
                out[S + i, j] += part
        # The turn between the sample and the state, about any axis.
        out[S + i, i] += sigma**2 + turned_sq * (x * x + y * y + z_ * z_)
    return _offset_innovation(out, b, known, 3)


@compiled
def baro_innovation(
    z: Vector, at: Vector, b: Vector, known: bool, sigma: float, out: Vector
) -> tuple[int, int]:
    """Pressure altitude less height is constant."""
    if not z[0] > 0.0:
        return NO_PRESSURE, 0
    out[V, 0] = pressure_altitude_m(z[0]) - at[HEIGHT]
    out[S, 0] = sigma**2 + at[P_POSITION + 8]
    return _offset_innovation(out, b, known, 1)


@compiled
def airspeed_innovation(
    z: Vector, at: Vector, b: Vector, known: bool, sigma: float, out: Vector
) -> tuple[int, int]:
    """Dynamic pressure is that of the velocity less a horizontal wind."""
    if not np.isfinite(z[0]):
        return NO_AIR_DATA, 0
    speed = math.sqrt(2.0 * max(z[0], 0.0) / density_kgpm3(at[HEIGHT]))
    if not known:
        if speed < SLOW_AIR_MPS:
            return SLOW_AIR, 0
        out[S, 0] = out[S + 1, 1] = WIND_MPS**2
        return STARTED, 2
    air = np.array([at[V_NED] - b[0], at[V_NED + 1] - b[1], at[V_NED + 2]])
    predicted = math.sqrt(air[0] * air[0] + air[1] * air[1] + air[2] * air[2])
    if predicted < SLOW_AIR_MPS:
        return SLOW_AIR, 0
    out[V, 0] = speed - predicted
    out[H, 0], out[H, 1] = -air[0] / predicted, -air[1] / predicted
    out[S, 0] = sigma**2
    for k in range(9):
        out[S, 0] += air[k // 3] * at[P_VELOCITY + k] * air[k % 3] / (predicted * predicted)
    return TESTED, 1


@compiled
def range_innovation(
    z: Vector, at: Vector, b: Vector, known: bool, sigma: float, out: Vector
) -> tuple[int, int]:
    """Height less the vertical part of the distance is that of the terrain."""
    if not np.isfinite(z[0]):
        return NO_RANGE, 0
    known_upright = at[UPRIGHT] != 0.0
    upright = at[ROT + 8] if known_upright else 1.0
    if upright < LEAST_UPRIGHT:
        return TILTED, 0
    level = z[0] * math.sqrt(1.0 - min(upright, 1.0) ** 2)
    tilt = (at[P_ATTITUDE] + at[P_ATTITUDE + 4] + at[P_ATTITUDE + 8]) / 3.0
    out[V, 0] = at[HEIGHT] - z[0] * upright
    # An attitude error moves the height of the beam's foot by its horizontal part times the angle.
    slant = level**2 * tilt if known_upright else (UNKNOWN_SLANT * z[0]) ** 2
    out[S, 0] = sigma**2 + at[P_POSITION + 8] + slant
    return _offset_innovation(out, b, known, 1)


@compiled
def vision_innovation(
    z: Vector, at: Vector, b: Vector, known: bool, sigma: float, out: Vector
) -> tuple[int, int]:
    """The origin of a local position, in ECEF, is constant."""
    if not _finite(z):
        return NO_POSITION, 0
    trace = at[P_POSITION] + at[P_POSITION + 4] + at[P_POSITION + 8]
    for i in range(3):
        origin = at[R + i]
        for j in range(3):
            origin -= at[AXES + 3 * j + i] * z[j]
        if known:
            for j in range(3):
                out[V, j] += at[AXES + 3 * j + i] * (origin - b[i])
                out[H + i, j] = at[AXES + 3 * i + j]
                out[S + i, j] = at[P_POSITION + 3 * i + j]
            out[S + i, i] += sigma**2
        else:
            out[V, i], out[S + i, i] = origin, sigma**2 + trace / 3.0
    return (TESTED if known else STARTED), 3


@compiled
def gps_position_innovation(
    z: Vector, at: Vector, b: Vector, known: bool, sigma: float, out: Vector
) -> tuple[int, int]:
    """The receiver's position, moved to the epoch by the velocity, has a small constant offset."""
    if z[FIX_TYPE] < FIX_3D:
        return NO_FIX, 0
    x, y, z_ = ecef_of(math.radians(z[0]), math.radians(z[1]), z[2])
    off = np.array([x - at[R], y - at[R + 1], z_ - at[R + 2]])
    for i in range(3):
        out[V, i] = at[V_NED + i] * at[LATE_S]
        for j in range(3):
            out[V, i] += at[AXES + 3 * i + j] * off[j]
            out[S + i, j] = at[P_POSITION + 3 * i + j]
        out[S + i, i] += sigma**2
    return _offset_innovation(out, b, known, 3)


@compiled
def gps_velocity_innovation(
    z: Vector, at: Vector, b: Vector, known: bool, sigma: float, out: Vector
) -> tuple[int, int]:
    """The receiver's velocity is the filter's; its vertical part may be missing."""
    if z[FIX_TYPE] < FIX_3D or not np.isfinite(z[FIX_VELOCITY]):
        return NO_VELOCITY, 0
    if not known:
        return STARTED, 0
    count = 3 if np.isfinite(z[FIX_TYPE - 1]) else 2
    for i in range(count):
        out[V, i] = z[FIX_VELOCITY + i] - at[V_NED + i]
        for j in range(count):
            out[S + i, j] = at[P_VELOCITY + 3 * i + j]
        out[S + i, i] += sigma**2
    return TESTED, count
