"""The receiver's navigation solution: weighted least squares on pseudoranges and Doppler.

It uses the broadcast data (orbits, clocks, Klobuchar coefficients) and the troposphere model, and
solves for position and one clock offset per satellite system, then for velocity and clock drift. It
has no integrity monitoring: a faulty satellite shifts the solution.
"""

import math

import msgspec
import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from simvehicle.gnss.pseudorange import (
    DELAY,
    LINE_OF_SIGHT,
    RANGE,
    RANGE_RATE,
    SAT_CLOCK,
    SAT_CLOCK_RATE,
    SAT_ELEVATION,
    Atmosphere,
    signal_geometry,
)
from simvehicle.gnss.satellite_orbits import Orbits, satellite_state

EARTH_RADIUS_M = 6.37e6
STILL = np.zeros(3)
EPH_MAX_M = 100.0  # horizontal sigma above which there is no 3D fix; chosen
EPH_MAX_2D_M = 1000.0  # the same for a 2D fix, whose error follows that of the assumed height
LAST_HEIGHT_SIGMA_M, SEA_HEIGHT_SIGMA_M = 50.0, 500.0  # chosen: height change in a 2D fix; terrain
ITERATIONS_MAX = 12
CONVERGED_M = 1e-4  # chosen: far below any measurement error
SMALL_STEP_M = 10.0  # the linearisation is valid over such a step
ZENITH_SIGMA_M = 0.5  # assumed pseudorange error at the zenith
SINE_MIN = 0.05  # of 3 degrees, the lowest elevation of the atmospheric models
RANK_TOLERANCE = 1e-6  # of the largest singular value; below it the geometry counts as singular


class ReceiverFix(msgspec.Struct, frozen=True):
    """A navigation solution; `clock_m` (m,) has one offset per system, GPS first.

    `fix_type` is MAVLink's: 0 no satellites, 1 no fix, 2 two-dimensional (one satellite too few:
    the height is fixed to the last one, or to the ellipsoid), 3 three-dimensional. Without a fix
    the position is the last one (all zero if there was none), and the velocity is zero.
    `sigma_ned_m` (3,) is the receiver's own estimate.
    """

    fix_type: int
    satellites: int
    r_ecef_m: Array
    lat_rad: float
    lon_rad: float
    height_m: float
    v_ned_mps: Array
    clock_m: Array
    sigma_ned_m: Array


NO_FIX = ReceiverFix(0, 0, STILL, 0.0, 0.0, 0.0, STILL, np.zeros(0), np.full(3, np.inf))


def solve_receiver_fix(
    orbits: Orbits,
    tow_s: float,
    pseudorange_m: Array,
    doppler_mps: Array,
    atmosphere: Atmosphere,
    last: ReceiverFix = NO_FIX,
) -> ReceiverFix:
    """Position, velocity and clock of one epoch.

    Parameters
    ----------
    orbits : Orbits
        Of the n observed satellites.
    tow_s : float
        Time of reception on the receiver's clock, in seconds of the week of `orbits`.
    pseudorange_m, doppler_mps : (n,) arrays
        Observations; the range rate is positive when the range grows.
    atmosphere, last
        The delays to correct, and the last fix to start from.
    """
    letters = [name[0] for name in orbits.satellites]
    systems = sorted(set(letters), reverse=True)  # GPS before Galileo
    count = len(letters)
    # The unknowns are three coordinates and a clock per system.
    lacking = 3 + max(len(systems), 1) - count
    if lacking > 1:
        return _no_fix(count, last)
    clocks = np.array([[letter == system for system in systems] for letter in letters], float)
    # The last solution is a start only if its clocks are those of the same systems.
    near = last.fix_type >= 2 and len(last.clock_m) == len(systems)
    if near:
        x = np.concatenate([last.r_ecef_m, last.clock_m])
    else:
        x = np.concatenate([_point_below_satellites(orbits, tow_s), np.zeros(len(systems))])
    height = _known_height(last) if lacking == 1 else None
    for _ in range(ITERATIONS_MAX):
        own_s = tow_s - float(x[3]) / SPEED_OF_LIGHT_MPS
        geometry = signal_geometry(orbits.table, own_s, x, STILL, *atmosphere)
        design, residual, root = _linearised(geometry, pseudorange_m, clocks, x, height)
        # The first iterations are unweighted, as elevations need a position.
        step = _least_squares(design, residual, root if near else np.ones(len(root)))
        if step is None:
            return _no_fix(count, last)  # satellites in one plane
        x += step
        size_m = np.abs(step).max()
        if near and size_m < SMALL_STEP_M:
            break
        near = near or bool(size_m < CONVERGED_M)
    else:
        return _no_fix(count, last)
    lat, lon, height_m = geodetic_position(x[:3])
    axes, weighted = ned_axes(lat, lon), design * root[:, None]
    covariance = axes @ np.linalg.inv(weighted.T @ weighted)[:3, :3] @ axes.T
    sigma = np.sqrt(np.diag(covariance))
    if math.hypot(sigma[0], sigma[1]) > (EPH_MAX_2D_M if lacking == 1 else EPH_MAX_M):
        return _no_fix(count, last)
    v_ned_mps = axes @ _velocity(geometry, doppler_mps, design, root)
    kind = 2 if lacking == 1 else 3
    return ReceiverFix(kind, count, x[:3], lat, lon, height_m, v_ned_mps, x[3:], sigma)


def _linearised(
    geometry: Array,
    pseudorange_m: Array,
    clocks: Array,
    x: Array,
    height: tuple[float, float] | None,
) -> tuple[Array, Array, Array]:
    """Design matrix, residuals and square roots of the weights of the ranges at x, and of an
    assumed height with its sigma."""
    model_m = geometry[RANGE] - SPEED_OF_LIGHT_MPS * geometry[SAT_CLOCK] + geometry[DELAY]
    # Moving towards the satellite shortens the range.
    design = np.hstack([-geometry[LINE_OF_SIGHT:].T, clocks])
    residual = pseudorange_m - model_m - clocks @ x[3:]
    # Errors grow towards the horizon roughly with the inverse sine of the elevation.
    root = np.maximum(np.sin(geometry[SAT_ELEVATION]), SINE_MIN) / ZENITH_SIGMA_M
    if height is None:
        return design, residual, root
    lat, lon, height_m = geodetic_position(x[:3])
    up = np.append(-ned_axes(lat, lon)[2], np.zeros(clocks.shape[1]))
    residual = np.append(residual, height[0] - height_m)
    return np.vstack([design, up]), residual, np.append(root, 1.0 / height[1])


def _velocity(geometry: Array, doppler_mps: Array, design: Array, root: Array) -> Array:
    """The velocity (3,) by the range rates; with an assumed height it is horizontal."""
    count = len(doppler_mps)
    design, residual = np.column_stack([design[:, :3], np.zeros(len(root))]), np.zeros(len(root))
    design[:count, 3] = 1.0
    clock_rate_mps = SPEED_OF_LIGHT_MPS * geometry[SAT_CLOCK_RATE]
    residual[:count] = doppler_mps - geometry[RANGE_RATE] + clock_rate_mps
    motion = _least_squares(design, residual, root)
    return np.zeros(3) if motion is None else motion[:3]


def _least_squares(design: Array, residual: Array, root: Array) -> Array | None:
    """Weighted solution, by square roots of the weights (n,); None without full rank."""
    weighted, right = design * root[:, None], residual * root
    solution, _, rank, _ = np.linalg.lstsq(weighted, right, rcond=RANK_TOLERANCE)
    return np.asarray(solution, np.float64) if rank == design.shape[1] else None


def _known_height(last: ReceiverFix) -> tuple[float, float]:
    """Assumed height [m] and its sigma: the last one, or the ellipsoid."""
    known = last.r_ecef_m.any()
    return last.height_m, LAST_HEIGHT_SIGMA_M if known else SEA_HEIGHT_SIGMA_M


def _point_below_satellites(orbits: Orbits, tow_s: float) -> Array:
    """Initial position (3,) on the Earth's surface, below the mean of the satellites."""
    # The mean of the satellites in view is roughly in the zenith.
    middle = np.mean([satellite_state(row, tow_s)[:3] for row in orbits.table], axis=0)
    return np.asarray(EARTH_RADIUS_M * middle / np.linalg.norm(middle))


def _no_fix(count: int, last: ReceiverFix) -> ReceiverFix:
    """A result without a fix; it keeps the last position."""
    place = last.r_ecef_m, last.lat_rad, last.lon_rad, last.height_m
    return ReceiverFix(min(count, 1), count, *place, STILL, NO_FIX.clock_m, NO_FIX.sigma_ned_m)
