"""Measurement models of the sensors: one function computes the innovation of each.

Each takes the numbers z of the newest sample (see `analysis.samples.block`), the filter's view at
the epoch, the sensor's slow states b if they are known, how much older the sample is in s, and one
sigma of its noise. It returns an innovation, the first slow states, or why it cannot be tested.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.propagation import cross_matrix
from analysis.samples.block import FIX_3D, FIX_TYPE, FIX_VELOCITY
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

SEA_LEVEL_PA = 101_325.0  # ICAO standard atmosphere, Doc 7488
ISA_KELVIN, ISA_LAPSE, ISA_EXPONENT = 288.15, 6.5e-3, 5.25588  # the same: K, K/m, g M / (R L)
LEAST_UPRIGHT = 0.7  # cosine of 45 degrees: a beam that is tilted more may miss the terrain below
UNKNOWN_SLANT = 0.1  # of the distance: the error of an unknown tilt of up to 25 degrees, 1 - cos
# Below it a 1 psi sensor errs by three times the 22 Pa (69 Pa, 4525DO data sheet: total error 1 %).
SLOW_AIR_MPS = 6.0
WIND_MPS = 6.0  # one sigma of the unknown wind: 12 m/s (6 Beaufort) in one of twenty flights


class FilterView(NamedTuple):
    """The filter at an epoch as the models see it.

    `r_m` (3,) in ECEF, `v_mps` (3,) and the covariances (3, 3) of position, velocity and attitude
    in NED; `axes` (3, 3) has the rows north, east, down in ECEF; `rot` (3, 3) is body to NED, None
    if the attitude is unknown; `turning_rps` is the largest rate of turn since the last epoch.
    """

    r_m: Vector
    height_m: float
    v_mps: Vector
    axes: Vector
    rot: Vector | None
    p_position: Vector
    p_velocity: Vector
    p_attitude: Vector
    turning_rps: float


class Innovation(NamedTuple):
    """The innovation v (m,), the variance r (m, m) of all but the slow states, and its sensitivity
    h (m, k) to these."""

    v: Vector
    r: Vector
    h: Vector


class SlowStates(NamedTuple):
    """A sensor's slow states b (k,) and their covariance p (k, k)."""

    b: Vector
    p: Vector


Outcome = Innovation | SlowStates | str
Model = Callable[[Vector, FilterView, Vector | None, float, float], Outcome]


class SensorModel(NamedTuple):
    """A sensor's model, one sigma of its noise, and the walk of its slow states per square root of
    a second; `least_sigma` is that which it may prove to have."""

    innovation: Model
    sigma: float
    least_sigma: float
    walk: float


def view_filter(motion: MotionEstimate, turning_rps: float) -> FilterView:
    """The filter as the models see it."""
    lat, lon, height = geodetic_position(motion.x[:3])
    axes = ned_axes(lat, lon)
    rot = axes @ rotation_matrix(motion.x[6:10]) if motion.inertial else None
    of_position, of_velocity, of_attitude = (
        axes @ motion.p[i : i + 3, i : i + 3] @ axes.T for i in (0, 3, 6)
    )
    return FilterView(
        r_m=motion.x[:3],
        height_m=height,
        v_mps=axes @ motion.x[3:6],
        axes=axes,
        rot=rot,
        p_position=of_position,
        p_velocity=of_velocity,
        p_attitude=of_attitude,
        turning_rps=turning_rps,
    )


def pressure_altitude_m(pressure_pa: float) -> float:
    """Altitude in the standard atmosphere below 11 km."""
    ratio = math.pow(pressure_pa / SEA_LEVEL_PA, 1.0 / ISA_EXPONENT)
    return ISA_KELVIN / ISA_LAPSE * (1.0 - ratio)


def density_kgpm3(altitude_m: float) -> float:
    """Density in the standard atmosphere below 11 km."""
    share = max(1.0 - ISA_LAPSE * altitude_m / ISA_KELVIN, 0.1)
    return SEA_LEVEL_DENSITY_KGPM3 * math.pow(share, ISA_EXPONENT - 1.0)


def _offset_innovation(v: Vector, r: Vector, b: Vector | None) -> Innovation | SlowStates:
    """The innovation of a sensor of its own slow states: less these, or these initially."""
    return SlowStates(v, r) if b is None else Innovation(v - b, r, np.eye(len(v)))


def _mag(z: Vector, at: FilterView, b: Vector | None, late_s: float, sigma: float) -> Outcome:
    """The field in NED is constant."""
    if at.rot is None:
        return "attitude not known"
    if not np.isfinite(z[:3]).all():
        return "the field is not finite"
    v = at.rot @ z[:3]
    # A small rotation moves the field by its cross product: the attitude's uncertainty.
    cross = cross_matrix(v)
    # The turn between the sample and the state, about any axis.
    turned_sq = (late_s * at.turning_rps) ** 2 * (v @ v)
    r = cross @ at.p_attitude @ cross.T + (sigma**2 + turned_sq) * np.eye(3)
    return _offset_innovation(v, r, b)


def _baro(z: Vector, at: FilterView, b: Vector | None, late_s: float, sigma: float) -> Outcome:
    """Pressure altitude less height is constant."""
    if not z[0] > 0.0:
        return "the pressure is not positive"
    v = np.array([pressure_altitude_m(z[0]) - at.height_m])
    return _offset_innovation(v, sigma**2 + at.p_position[2:, 2:], b)


def _airspeed(z: Vector, at: FilterView, b: Vector | None, late_s: float, sigma: float) -> Outcome:
    """Dynamic pressure is that of the velocity less a horizontal wind."""
    if not np.isfinite(z[0]):
        return "the pressure is not finite"
    speed = math.sqrt(2.0 * max(z[0], 0.0) / density_kgpm3(at.height_m))
    air = at.v_mps if b is None else at.v_mps - (*b, 0.0)
    predicted = speed if b is None else math.hypot(*air)
    if predicted < SLOW_AIR_MPS:
        return f"airspeed below {SLOW_AIR_MPS:.0f} m/s"
    if b is None:
        return SlowStates(np.zeros(2), WIND_MPS**2 * np.eye(2))
    along = air / predicted
    r = np.array([[sigma**2 + along @ at.p_velocity @ along]])
    return Innovation(np.array([speed - predicted]), r, -along[None, :2])


def _range(z: Vector, at: FilterView, b: Vector | None, late_s: float, sigma: float) -> Outcome:
    """Height less the vertical part of the distance is that of the terrain."""
    if not np.isfinite(z[0]):
        return "the distance is not finite"
    upright = 1.0 if at.rot is None else at.rot[2, 2]
    if upright < LEAST_UPRIGHT:
        return "tilted by more than 45 degrees"
    # An attitude error moves the height of the beam's foot by its horizontal part times the angle.
    level_sq = z[0] ** 2 * (1.0 - min(upright, 1.0) ** 2)
    known = at.rot is not None
    slant = level_sq * np.trace(at.p_attitude) / 3.0 if known else (UNKNOWN_SLANT * z[0]) ** 2
    r = sigma**2 + at.p_position[2:, 2:] + slant
    return _offset_innovation(np.array([at.height_m - z[0] * upright]), r, b)


def _vision(z: Vector, at: FilterView, b: Vector | None, late_s: float, sigma: float) -> Outcome:
    """The origin of a local position, in ECEF, is constant."""
    if not np.isfinite(z[:3]).all():
        return "the position is not finite"
    origin = at.r_m - at.axes.T @ z[:3]
    if b is None:
        return SlowStates(origin, (sigma**2 + np.trace(at.p_position) / 3.0) * np.eye(3))
    r = at.p_position + sigma**2 * np.eye(3)
    return Innovation(at.axes @ (origin - b), r, at.axes)


def _gps_position(
    z: Vector, at: FilterView, b: Vector | None, late_s: float, sigma: float
) -> Outcome:
    """The receiver's position, moved to the epoch by the velocity, has a small constant offset."""
    if z[FIX_TYPE] < FIX_3D:
        return f"fix type {z[FIX_TYPE]:.0f}"
    off = ecef_from_geodetic(math.radians(z[0]), math.radians(z[1]), z[2]) - at.r_m
    v = late_s * at.v_mps + at.axes @ off
    return _offset_innovation(v, at.p_position + sigma**2 * np.eye(3), b)


def _gps_velocity(
    z: Vector, at: FilterView, b: Vector | None, late_s: float, sigma: float
) -> Outcome:
    """The receiver's velocity is the filter's; its vertical part may be missing."""
    if z[FIX_TYPE] < FIX_3D or not np.isfinite(z[FIX_VELOCITY]):
        return "no velocity"
    if b is None:
        return SlowStates(np.zeros(0), np.zeros((0, 0)))
    count = 3 if np.isfinite(z[FIX_TYPE - 1]) else 2
    v = z[FIX_VELOCITY : FIX_VELOCITY + count] - at.v_mps[:count]
    r = at.p_velocity[:count, :count] + sigma**2 * np.eye(count)
    return Innovation(v, r, np.zeros((count, 0)))


# One sigma of small autopilots' sensors as mounted, and the walk of the slow states. No row of
# benchmarks/preset_table.py isolates a healthy sensor.
# mag: currents and iron, 6 % of 0.5 gauss; less if it proves to be better mounted.
# baro: 8 Pa or 0.66 m (BMP388 data sheet, table 2) and wind at its port; weather, 3 m in an hour.
# airspeed: 20 Pa (drift of an MPXV5004DP by Beard and McLain, appendix H), 1.1 m/s at 15 m/s.
# gps-position: 2.0 m within 50 % (u-blox NEO-M9N, UBX-19014285) is 1.7 m, most of it a slow offset.
# gps-velocity: 0.05 m/s in steady motion (as `NATURAL_MPS`); up to 0.1 s late at 3 m/s^2.
MODELS = {
    "mag": SensorModel(_mag, 0.03, 0.01, 2e-4),  # gauss
    "baro": SensorModel(_baro, 1.0, 1.0, 0.05),  # m
    "airspeed": SensorModel(_airspeed, 1.0, 1.0, 0.3),  # m/s; the wind walks
    "range": SensorModel(_range, 0.5, 0.5, 0.5),  # m; the terrain walks
    "vision": SensorModel(_vision, 0.5, 0.5, 0.1),  # m
    "gps-position": SensorModel(_gps_position, 1.5, 1.5, 0.1),  # m
    "gps-velocity": SensorModel(_gps_velocity, 0.4, 0.4, 0.0),  # m/s
}
