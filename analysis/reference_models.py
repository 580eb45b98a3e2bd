"""What each sensor should say where the filter is: one function a sensor.

Each takes the sample, the filter's view, the sensor's slow states and the noise, and gives what a
test needs (`Seen`), or first slow states (`Slow`) to start with, or why it cannot be tested (text).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.fdi.state import Motion
from analysis.reference_kernel import local
from analysis.samples import (
    AirspeedSample,
    BaroSample,
    GpsFix,
    MagSample,
    RangeSample,
    Vector,
    VisionSample,
)
from simvehicle.earth import ecef_from_geodetic

SEA_LEVEL_PA = 101_325.0  # ICAO standard atmosphere, Doc 7488
SEA_LEVEL_KGPM3 = 1.225
ISA_KELVIN, ISA_LAPSE, ISA_EXPONENT = 288.15, 6.5e-3, 5.25588
DENSITY_EXPONENT = 4.25588
SLOW_AIR_MPS = 6.0  # below it a pitot tube says little


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorNoise:
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


@dataclass(frozen=True, slots=True)
class Slow:
    """A sensor's slow states b (k,) with covariance p (k, k) at `t_us`; `walk` (k,) their variance
    per second."""

    t_us: int
    b: Vector
    p: Vector
    walk: Vector


@dataclass(frozen=True, slots=True)
class Seen:
    """Innovation v (m,) and its sensitivity h (m, k) to the slow states.

    r (m, m) is the variance that the filter and the sensor leave.
    """

    v: Vector
    h: Vector
    r: Vector
    slow: Slow


@dataclass(frozen=True, slots=True)
class View:
    """The filter in local terms: height, NED velocity, attitude rot_nb, and covariances in NED."""

    t_us: int
    r_ecef_m: Vector
    lat_rad: float
    height_m: float
    axes: Vector
    v_ned_mps: Vector
    rot_nb: Vector | None
    p_position: Vector
    p_velocity: Vector
    p_attitude: Vector


Outcome = Seen | Slow | str


def view(motion: Motion) -> View:
    """The filter as the sensors see it; no attitude while the IMU does not move it."""
    lat, height, axes, v_ned, rot_nb, covariances = local(motion.x, motion.p)
    return View(
        motion.t_us,
        motion.x[0:3],
        lat,
        height,
        axes,
        v_ned,
        rot_nb if motion.inertial else None,
        *covariances,
    )


def pressure_altitude_m(pressure_pa: float) -> float:
    """Altitude in the standard atmosphere below 11 km."""
    ratio = math.pow(pressure_pa / SEA_LEVEL_PA, 1.0 / ISA_EXPONENT)
    return ISA_KELVIN / ISA_LAPSE * (1.0 - ratio)


def density_kgpm3(altitude_m: float) -> float:
    """Density in the standard atmosphere below 11 km."""
    return float(
        SEA_LEVEL_KGPM3 * max(1.0 - ISA_LAPSE * altitude_m / ISA_KELVIN, 0.1) ** DENSITY_EXPONENT
    )


def _offset(t_us: int, first: Vector, sigma: float, walk: float) -> Slow:
    size = len(first)
    return Slow(t_us, first, np.eye(size) * sigma**2, np.full(size, walk**2))


def _baro(sample: BaroSample, at: View, slow: Slow | None, noise: SensorNoise) -> Outcome:
    if not sample.pressure_pa > 0.0:
        return "the pressure is not positive"
    difference = np.array([pressure_altitude_m(sample.pressure_pa) - at.height_m])
    if slow is None:
        sigma = math.hypot(noise.baro_m, math.sqrt(at.p_position[2, 2]))
        return _offset(at.t_us, difference, sigma, noise.baro_walk_m)
    r = np.array([[noise.baro_m**2 + at.p_position[2, 2]]])
    return Seen(difference - slow.b, np.eye(1), r, slow)


def _airspeed(sample: AirspeedSample, at: View, slow: Slow | None, noise: SensorNoise) -> Outcome:
    if not math.isfinite(sample.diff_pressure_pa):
        return "the pressure is not finite"
    speed = math.sqrt(2.0 * max(sample.diff_pressure_pa, 0.0) / density_kgpm3(at.height_m))
    if slow is None:
        if speed < SLOW_AIR_MPS:
            return f"airspeed below {SLOW_AIR_MPS:.0f} m/s"
        return _offset(at.t_us, np.zeros(2), 6.0, noise.wind_walk_mps)
    air = at.v_ned_mps - np.array([slow.b[0], slow.b[1], 0.0])
    predicted = float(np.linalg.norm(air))
    if predicted < SLOW_AIR_MPS:
        return f"airspeed below {SLOW_AIR_MPS:.0f} m/s"
    along = air / predicted
    r = np.array([[noise.airspeed_mps**2 + along @ at.p_velocity @ along]])
    return Seen(np.array([speed - predicted]), -along[None, :2], r, slow)


def _mag(sample: MagSample, at: View, slow: Slow | None, noise: SensorNoise) -> Outcome:
    if at.rot_nb is None:
        return "attitude not known"
    if not np.isfinite(sample.field_b_gauss).all():
        return "the field is not finite"
    field_ned = at.rot_nb @ sample.field_b_gauss
    x, y, z = field_ned
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    r = cross @ at.p_attitude @ cross.T + noise.mag_gauss**2 * np.eye(3)
    if slow is None:
        return Slow(at.t_us, field_ned, r.copy(), np.full(3, noise.field_walk_gauss**2))
    return Seen(field_ned - slow.b, np.eye(3), r, slow)


def _vision(sample: VisionSample, at: View, slow: Slow | None, noise: SensorNoise) -> Outcome:
    if not np.isfinite(sample.r_ned_m).all():
        return "the position is not finite"
    origin = at.r_ecef_m - at.axes.T @ sample.r_ned_m
    if slow is None:
        sigma = math.hypot(noise.vision_m, math.sqrt(float(np.trace(at.p_position)) / 3.0))
        return _offset(at.t_us, origin, sigma, noise.vision_walk_m)
    v = at.axes @ (origin - slow.b)
    r = at.p_position + noise.vision_m**2 * np.eye(3)
    return Seen(v, at.axes.copy(), r, slow)


def _range(sample: RangeSample, at: View, slow: Slow | None, noise: SensorNoise) -> Outcome:
    if not math.isfinite(sample.distance_m):
        return "the distance is not finite"
    upright = float(at.rot_nb[2, 2]) if at.rot_nb is not None else 1.0
    if upright < 0.7:
        return "tilted by more than 45 degrees"
    terrain = np.array([at.height_m - sample.distance_m * upright])
    level = sample.distance_m * math.sqrt(1.0 - min(upright, 1.0) ** 2)
    tilt = float(np.trace(at.p_attitude)) / 3.0 if at.rot_nb is not None else 0.0
    variance = noise.range_m**2 + float(at.p_position[2, 2]) + level**2 * tilt
    if slow is None:
        return _offset(at.t_us, terrain, math.sqrt(variance), noise.terrain_walk_m)
    return Seen(terrain - slow.b, np.eye(1), np.array([[variance]]), slow)


def _gps_position(sample: GpsFix, at: View, slow: Slow | None, noise: SensorNoise) -> Outcome:
    if sample.fix_type < 3:
        return f"fix type {sample.fix_type}"
    lat, lon = math.radians(sample.lat_deg), math.radians(sample.lon_deg)
    r_ecef = np.asarray(ecef_from_geodetic(lat, lon, sample.alt_m))
    # A stamp between two epochs: the filter's velocity carries the fix to the epoch.
    late_s = (at.t_us - sample.t_us) * 1e-6
    v = at.axes @ (r_ecef - at.r_ecef_m) + at.v_ned_mps * late_s
    r = at.p_position + noise.gps_m**2 * np.eye(3)
    if slow is None:
        return Slow(at.t_us, v, r.copy(), np.full(3, noise.gps_walk_m**2))
    return Seen(v - slow.b, np.eye(3), r, slow)


def _gps_velocity(sample: GpsFix, at: View, slow: Slow | None, noise: SensorNoise) -> Outcome:
    if sample.fix_type < 3 or sample.v_ned_mps is None:
        return "no velocity"
    if slow is None:
        return Slow(at.t_us, np.zeros(0), np.zeros((0, 0)), np.zeros(0))
    known = np.isfinite(sample.v_ned_mps)
    v = (sample.v_ned_mps - at.v_ned_mps)[known]
    r = (at.p_velocity + noise.gps_mps**2 * np.eye(3))[known][:, known]
    return Seen(v, np.zeros((len(v), 0)), np.ascontiguousarray(r), slow)


MODELS: dict[str, Callable[[Any, View, Slow | None, SensorNoise], Outcome]] = {
    "baro": _baro,
    "airspeed": _airspeed,
    "mag": _mag,
    "vision": _vision,
    "range": _range,
    "gps-position": _gps_position,
    "gps-velocity": _gps_velocity,
}
