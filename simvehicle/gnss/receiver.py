"""The receiver's own navigation solution: weighted least squares on pseudoranges and Doppler.

It knows what is broadcast (orbits, clocks, Klobuchar's coefficients) and the troposphere's model,
solves for position and one clock offset per satellite system, then for velocity and clock drift. It
tests nothing: a faulty satellite moves the solution, as in a receiver without integrity monitoring.
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
EPH_MAX_M = 100.0  # worse is no fix
EPH_MAX_2D_M = 1000.0  # a two-dimensional fix stands and falls with the height it holds
LAST_HEIGHT_SIGMA_M, SEA_HEIGHT_SIGMA_M = 50.0, 500.0
NO_KNOWN_HEIGHT = (math.nan, 1.0)  # no height is held
REASONS = {kernel.SINGULAR: "satellites in one plane", kernel.DIVERGED: "no convergence"}


class ReceiverFix(msgspec.Struct, frozen=True):
    """A solution; `clock_m` (m,) are the offsets by system, the first GPS's if there is one.

    `fix_type` is MAVLink's: 0 no satellites, 1 no fix, 2 two-dimensional (one satellite too few, so
    the height is held at the last one, or at the ellipsoid's), 3 three-dimensional. Without a fix
    the place is the last one (all zero if there was none), nothing moves, and `reason` says why.
    `sigma_ned_m` (3,) is what the receiver believes.
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
        Of the n satellites observed.
    tow_s : float
        Time of reception by the receiver's clock, in seconds of the week of `orbits`.
    pseudorange_m, doppler_mps : (n,) arrays
        Observations; the range rate is positive when the range grows.
    atmosphere, last
        What to correct for; where to start from, if anywhere.
    """
    letters = [name[0] for name in orbits.satellites]
    systems = sorted(set(letters), reverse=True)  # GPS before Galileo
    count = len(letters)
    # Three coordinates and a clock for each system are solved for.
    lacking = 3 + max(len(systems), 1) - count
    if lacking > 1:
        return _no_fix(count, f"{count} satellites of {len(systems)} systems", last)
    # Clocks of other systems than last time: the last solution is no start.
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
    """Height to hold [m] and how wrong it may be: the last one, or the ellipsoid's."""
    if last is not None and last.r_ecef_m.any():
        return last.height_m, LAST_HEIGHT_SIGMA_M
    return 0.0, SEA_HEIGHT_SIGMA_M


def _point_below_satellites(orbits: Orbits, tow_s: float) -> Vector:
    """A place on the Earth's surface amid the satellites, to start from."""
    # The mean of what is seen points to the zenith, roughly: the iteration finds the rest.
    middle = satellite_states(orbits, np.full(len(orbits.table), tow_s))[0].mean(axis=0)
    return np.asarray(EARTH_RADIUS_M * middle / np.linalg.norm(middle))


def _no_fix(count: int, reason: str, last: ReceiverFix | None) -> ReceiverFix:
    """No fix; the place stays the last one."""
    still, unknown = np.zeros(3), np.full(3, np.inf)
    if last is None:
        place, lat, lon, height = still, 0.0, 0.0, 0.0
    else:
        place, lat, lon, height = last.r_ecef_m, last.lat_rad, last.lon_rad, last.height_m
    fix_type = min(count, 1)
    return ReceiverFix(
        fix_type, count, place, lat, lon, height, still, still, np.zeros(0), 0.0, unknown, reason
    )
