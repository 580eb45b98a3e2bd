"""What each sensor should say where the filter is: one compiled function a sensor.

Each takes the numbers z of the newest sample (see `analysis.block`), the filter's view, the
sensor's slow states b (3,) if they are known, and the noise. It fills in what a test needs:
innovation v (m,), its sensitivity h (m, k) to the slow states and the rest r (m, m) of its
variance; or the first slow states in v (k,) and their covariance in r (k, k). It returns STARTED,
TESTED or the number of a reason why it cannot be tested, and m or k.
"""

import math
from collections.abc import Callable
from typing import NamedTuple, cast

import numpy as np

from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled
from simvehicle.earth import ecef_of

SEA_LEVEL_PA = 101_325.0  # ICAO standard atmosphere, Doc 7488
SEA_LEVEL_KGPM3 = 1.225
ISA_KELVIN, ISA_LAPSE, ISA_EXPONENT = 288.15, 6.5e-3, 5.25588
DENSITY_EXPONENT = 4.25588
SLOW_AIR_MPS = 6.0  # below it a pitot tube says little
WIND_MPS = 6.0  # one sigma of what the wind may be
FIX_3D = 3

MAG, BARO, AIRSPEED, RANGE, VISION, GPS_POSITION, GPS_VELOCITY = range(7)
SENSORS = ("mag", "baro", "airspeed", "range", "vision", "gps-position", "gps-velocity")
SLOW_STATES = (3, 1, 2, 1, 3, 3, 0)

NOTHING, STARTED, TESTED = 0, 1, 2
NO_ATTITUDE, NO_FIELD, NO_PRESSURE, NO_AIR_DATA, SLOW_AIR, NO_RANGE, TILTED = range(3, 10)
NO_POSITION, NO_FIX, NO_VELOCITY = range(10, 13)
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
}
_ecef_of = cast(Callable[[float, float, float], tuple[float, float, float]], compiled(ecef_of))


class SensorNoise(NamedTuple):
    """One sigma of each sensor, and how fast its slow states walk (per square root of a second)."""

    baro_m: float = 1.0
    baro_walk_m: float = 0.05
    airspeed_mps: float = 1.0
    wind_walk_mps: float = 0.3
    mag_gauss: float = 0.03
    field_walk_gauss: float = 1e-3
    vision_m: float = 0.5
    vision_walk_m: float = 0.1
    range_m: float = 0.5
    terrain_walk_m: float = 0.5
    gps_m: float = 1.5
    gps_walk_m: float = 0.1
    gps_mps: float = 0.4


class View(NamedTuple):
    """The filter in local terms: height, NED velocity, attitude rot_nb (known or not), and
    covariances in NED; `axes` are NED in ECEF. `late_s` is how much older the sample is."""

    r_ecef_m: Vector
    height_m: float
    axes: Vector
    v_ned_mps: Vector
    rot_nb: Vector
    upright: bool
    p_position: Vector
    p_velocity: Vector
    p_attitude: Vector
    late_s: float


@compiled
def pressure_altitude_m(pressure_pa: float) -> float:
    """Altitude in the standard atmosphere below 11 km."""
    ratio = math.pow(pressure_pa / SEA_LEVEL_PA, 1.0 / ISA_EXPONENT)
    return ISA_KELVIN / ISA_LAPSE * (1.0 - ratio)


@compiled
def density_kgpm3(altitude_m: float) -> float:
    """Density in the standard atmosphere below 11 km."""
    share = max(1.0 - ISA_LAPSE * altitude_m / ISA_KELVIN, 0.1)
    return SEA_LEVEL_KGPM3 * math.pow(share, DENSITY_EXPONENT)


@compiled
def _three(v: Vector, h: Vector, r: Vector, b: Vector, known: bool) -> tuple[int, int]:
    """A sensor that sees its own three slow states: less these, or these to begin with."""
    if not known:
        return STARTED, 3
    for i in range(3):
        v[i] -= b[i]
        h[i, i] = 1.0
    return TESTED, 3


@compiled
def _one(v: Vector, h: Vector, b: Vector, known: bool) -> tuple[int, int]:
    """The same for one slow state."""
    if not known:
        return STARTED, 1
    v[0] -= b[0]
    h[0, 0] = 1.0
    return TESTED, 1


@compiled
def mag(
    z: Vector, at: View, b: Vector, known: bool, noise: SensorNoise, v: Vector, h: Vector, r: Vector
) -> tuple[int, int]:
    """The field in NED is steady."""
    if not at.upright:
        return NO_ATTITUDE, 0
    if not (np.isfinite(z[0]) and np.isfinite(z[1]) and np.isfinite(z[2])):
        return NO_FIELD, 0
    for i in range(3):
        for j in range(3):
            v[i] += at.rot_nb[i, j] * z[j]
    cross = np.zeros((3, 3))
    cross[0, 1], cross[0, 2], cross[1, 2] = -v[2], v[1], -v[0]
    cross[1, 0], cross[2, 0], cross[2, 1] = v[2], -v[1], v[0]
    for i in range(3):
        r[i, i] = noise.mag_gauss**2
        for j in range(3):
            for k in range(3):
                for m in range(3):
                    r[i, j] += cross[i, k] * at.p_attitude[k, m] * cross[j, m]
    return _three(v, h, r, b, known)


@compiled
def baro(
    z: Vector, at: View, b: Vector, known: bool, noise: SensorNoise, v: Vector, h: Vector, r: Vector
) -> tuple[int, int]:
    """Pressure altitude less height is steady."""
    if not z[0] > 0.0:
        return NO_PRESSURE, 0
    v[0] = pressure_altitude_m(z[0]) - at.height_m
    r[0, 0] = noise.baro_m**2 + at.p_position[2, 2]
    return _one(v, h, b, known)


@compiled
def airspeed(
    z: Vector, at: View, b: Vector, known: bool, noise: SensorNoise, v: Vector, h: Vector, r: Vector
) -> tuple[int, int]:
    """Dynamic pressure is that of the velocity less a level wind."""
    if not np.isfinite(z[0]):
        return NO_AIR_DATA, 0
    speed = math.sqrt(2.0 * max(z[0], 0.0) / density_kgpm3(at.height_m))
    if not known:
        if speed < SLOW_AIR_MPS:
            return SLOW_AIR, 0
        r[0, 0] = r[1, 1] = WIND_MPS**2
        return STARTED, 2
    air = at.v_ned_mps.copy()
    air[0] -= b[0]
    air[1] -= b[1]
    predicted = math.sqrt(air[0] * air[0] + air[1] * air[1] + air[2] * air[2])
    if predicted < SLOW_AIR_MPS:
        return SLOW_AIR, 0
    v[0] = speed - predicted
    h[0, 0], h[0, 1] = -air[0] / predicted, -air[1] / predicted
    r[0, 0] = noise.airspeed_mps**2
    for i in range(3):
        for j in range(3):
            r[0, 0] += air[i] / predicted * at.p_velocity[i, j] * air[j] / predicted
    return TESTED, 1


@compiled
def rangefinder(
    z: Vector, at: View, b: Vector, known: bool, noise: SensorNoise, v: Vector, h: Vector, r: Vector
) -> tuple[int, int]:
    """Height less the distance, upright, is that of the terrain."""
    if not np.isfinite(z[0]):
        return NO_RANGE, 0
    upright = at.rot_nb[2, 2] if at.upright else 1.0
    if upright < 0.7:
        return TILTED, 0
    v[0] = at.height_m - z[0] * upright
    level = z[0] * math.sqrt(1.0 - min(upright, 1.0) ** 2)
    tilt = (at.p_attitude[0, 0] + at.p_attitude[1, 1] + at.p_attitude[2, 2]) / 3.0
    r[0, 0] = noise.range_m**2 + at.p_position[2, 2]
    if at.upright:
        r[0, 0] += level**2 * tilt
    return _one(v, h, b, known)


@compiled
def vision(
    z: Vector, at: View, b: Vector, known: bool, noise: SensorNoise, v: Vector, h: Vector, r: Vector
) -> tuple[int, int]:
    """The origin of a local position, in ECEF, is steady."""
    if not (np.isfinite(z[0]) and np.isfinite(z[1]) and np.isfinite(z[2])):
        return NO_POSITION, 0
    origin = at.r_ecef_m.copy()
    for i in range(3):
        for j in range(3):
            origin[i] -= at.axes[j, i] * z[j]
    if not known:
        trace = at.p_position[0, 0] + at.p_position[1, 1] + at.p_position[2, 2]
        for i in range(3):
            v[i], r[i, i] = origin[i], noise.vision_m**2 + trace / 3.0
        return STARTED, 3
    for i in range(3):
        for j in range(3):
            v[i] += at.axes[i, j] * (origin[j] - b[j])
            h[i, j] = at.axes[i, j]
            r[i, j] = at.p_position[i, j]
        r[i, i] += noise.vision_m**2
    return TESTED, 3


@compiled
def gps_position(
    z: Vector, at: View, b: Vector, known: bool, noise: SensorNoise, v: Vector, h: Vector, r: Vector
) -> tuple[int, int]:
    """The receiver's position, carried to the epoch by the filter's velocity, is off by little."""
    if z[6] < FIX_3D:
        return NO_FIX, 0
    place = _ecef_of(math.radians(z[0]), math.radians(z[1]), z[2])
    for i in range(3):
        for j in range(3):
            v[i] += at.axes[i, j] * (place[j] - at.r_ecef_m[j])
            r[i, j] = at.p_position[i, j]
        v[i] += at.v_ned_mps[i] * at.late_s
        r[i, i] += noise.gps_m**2
    return _three(v, h, r, b, known)


@compiled
def gps_velocity(
    z: Vector, at: View, b: Vector, known: bool, noise: SensorNoise, v: Vector, h: Vector, r: Vector
) -> tuple[int, int]:
    """The receiver's velocity is the filter's; its last part may be missing."""
    if z[6] < FIX_3D or not np.isfinite(z[3]):
        return NO_VELOCITY, 0
    if not known:
        return STARTED, 0
    count = 3 if np.isfinite(z[5]) else 2
    for i in range(count):
        v[i] = z[3 + i] - at.v_ned_mps[i]
        for j in range(count):
            r[i, j] = at.p_velocity[i, j]
        r[i, i] += noise.gps_mps**2
    return TESTED, count
