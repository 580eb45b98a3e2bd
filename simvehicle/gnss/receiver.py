"""The receiver's navigation solution: weighted least squares on pseudoranges and Doppler.

It uses the broadcast data (orbits, clocks, Klobuchar coefficients) and the troposphere model, and
solves for position and one clock offset per satellite system, then for velocity and clock drift. It
has no integrity monitoring: a faulty satellite shifts the solution.
"""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray

from simvehicle.gnss import receiver_kernel as kernel
from simvehicle.gnss.pseudorange import Atmosphere
from simvehicle.gnss.satellite_orbits import Orbits, satellite_states

Vector = NDArray[np.float64]

EARTH_RADIUS_M = 6.37e6
EPH_MAX_M = 100.0  # horizontal sigma above which there is no 3D fix; chosen
EPH_MAX_2D_M = 1000.0  # the same for a 2D fix, whose error follows that of the assumed height
LAST_HEIGHT_SIGMA_M, SEA_HEIGHT_SIGMA_M = 50.0, 500.0  # chosen: height change in a 2D fix; terrain
NO_KNOWN_HEIGHT = (math.nan, 1.0)  # height is estimated
REASONS = {kernel.SINGULAR: "satellites in one plane", kernel.DIVERGED: "no convergence"}


class ReceiverFix(msgspec.Struct, frozen=True):
    """A navigation solution; `clock_m` (m,) has one offset per system, GPS first.

    `fix_type` is MAVLink's: 0 no satellites, 1 no fix, 2 two-dimensional (one satellite too few:
    the height is fixed to the last one, or to the ellipsoid), 3 three-dimensional. Without a fix
    the position is the last one (all zero if there was none), the velocity is zero, and `reason`
    says why. `sigma_ned_m` (3,) is the receiver's own estimate.
    """

    fix_type: int
    satellites: int
    r_ecef_m: Vector
    lat_rad: float
    lon_rad: float
    height_m: float
    v_ecef_mps: Vector
    v_ned_mps: Vector
    clock_m: Vector
    drift_mps: float
    sigma_ned_m: Vector
    reason: str = ""


def solve_receiver_fix(
    orbits: Orbits,
    tow_s: float,
    pseudorange_m: Vector,
    doppler_mps: Vector,
    atmosphere: Atmosphere,
    last: ReceiverFix | None = None,
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
        return _no_fix(count, f"{count} satellites of {len(systems)} systems", last)
    # The last solution is a start only if its clocks are those of the same systems.
    near = last is not None and last.fix_type >= 2 and len(last.clock_m) == len(systems)
    start = (last.r_ecef_m, last.clock_m) if last is not None and near else None
    system = np.array([systems.index(letter) for letter in letters])
    out = kernel.solve_navigation(
        kernel.ReceiverObservations(orbits.table, system, pseudorange_m, doppler_mps),
        tow_s,
        atmosphere.coefficients,
        atmosphere.troposphere,
        np.concatenate(start or (_point_below_satellites(orbits, tow_s), np.zeros(len(systems)))),
        near,
        _known_height(last) if lacking == 1 else NO_KNOWN_HEIGHT,
    )
    if out[kernel.STATUS] != kernel.SOLVED:
        return _no_fix(count, REASONS[float(out[kernel.STATUS])], last)
    sigma = out[kernel.SIGMA : kernel.SIGMA + 3]
    if math.hypot(sigma[0], sigma[1]) > (EPH_MAX_2D_M if lacking == 1 else EPH_MAX_M):
        return _no_fix(count, "geometry too poor", last)
    return ReceiverFix(
        2 if lacking == 1 else 3,
        count,
        out[kernel.POSITION : kernel.POSITION + 3],
        float(out[kernel.GEODETIC]),
        float(out[kernel.GEODETIC + 1]),
        float(out[kernel.GEODETIC + 2]),
        out[kernel.VELOCITY : kernel.VELOCITY + 3],
        out[kernel.VELOCITY_NED : kernel.VELOCITY_NED + 3],
        out[kernel.CLOCK : kernel.CLOCK + len(systems)],
        float(out[kernel.DRIFT]),
        sigma,
    )


def _known_height(last: ReceiverFix | None) -> tuple[float, float]:
    """Assumed height [m] and its sigma: the last one, or the ellipsoid."""
    if last is not None and last.r_ecef_m.any():
        return last.height_m, LAST_HEIGHT_SIGMA_M
    return 0.0, SEA_HEIGHT_SIGMA_M


def _point_below_satellites(orbits: Orbits, tow_s: float) -> Vector:
    """Initial position (3,) on the Earth's surface, below the mean of the satellites."""
    # The mean of the satellites in view is roughly in the zenith.
    middle = satellite_states(orbits, np.full(len(orbits.table), tow_s))[0].mean(axis=0)
    return np.asarray(EARTH_RADIUS_M * middle / np.linalg.norm(middle))


def _no_fix(count: int, reason: str, last: ReceiverFix | None) -> ReceiverFix:
    """A result without a fix; it keeps the last position."""
    still, unknown = np.zeros(3), np.full(3, np.inf)
    if last is None:
        place, lat, lon, height = still, 0.0, 0.0, 0.0
    else:
        place, lat, lon, height = last.r_ecef_m, last.lat_rad, last.lon_rad, last.height_m
    fix_type = min(count, 1)
    return ReceiverFix(
        fix_type, count, place, lat, lon, height, still, still, np.zeros(0), 0.0, unknown, reason
    )
