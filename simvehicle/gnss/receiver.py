"""The receiver's own navigation solution: weighted least squares on pseudoranges and Doppler.

It knows what is broadcast (orbits, clocks, Klobuchar's coefficients) and the troposphere's model,
solves for position and one clock offset per satellite system, then for velocity and clock drift. It
tests nothing: a faulty satellite moves the solution, as in a receiver without integrity monitoring.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simvehicle.earth import geodetic_from_ecef, rot_en
from simvehicle.gnss.ephemeris import SPEED_OF_LIGHT_MPS, Orbits, satellite_states
from simvehicle.gnss.pseudorange import Atmosphere, Sight, sight

Vector = NDArray[np.float64]

ROUNDS_MAX = 12
CONVERGED_M = 1e-4
SURFACE_M = 6.37e6
RANGE_FLOOR_M = 0.5  # of the standard deviation a pseudorange is taken to have, in the zenith
RATE_SIGMA_MPS = 0.05
NO_MOTION = np.zeros(3)
EPH_MAX_M = 100.0  # worse is no fix


@dataclass(frozen=True, slots=True)
class Fix:
    """A solution; `clock_m` (m,) are the offsets by system, the first GPS's if there is one.

    `fix_type` is MAVLink's: 0 no satellites, 1 no fix, 3 three-dimensional; only with 3 are the
    other fields new. `sigma_ned_m` (3,) is what the receiver believes; `reason` says why there is
    no fix.
    """

    fix_type: int
    satellites: int
    r_ecef_m: Vector
    v_ecef_mps: Vector
    clock_m: Vector
    drift_mps: float
    sigma_ned_m: Vector
    reason: str = ""


def solve(
    orbits: Orbits,
    tow_s: float,
    pseudorange_m: Vector,
    doppler_mps: Vector,
    atmosphere: Atmosphere,
    last: Fix | None = None,
) -> Fix:
    """Position, velocity and clock of one epoch.

    Parameters
    ----------
    orbits : Orbits
        Of the n satellites observed.
    tow_s : float
        Time of reception by the receiver's clock, in seconds of the week of `orbits`.
    pseudorange_m, doppler_mps : (n,) arrays
        Observations; the range rate is positive when the range grows.
    atmosphere : Atmosphere
        What to correct for.
    last : Fix, optional
        Where to start from.
    """
    letters = [name[0] for name in orbits.satellites]
    systems = sorted(set(letters), reverse=True)  # GPS before Galileo
    count = len(letters)
    if count < 3 + len(systems) or count < 4:
        return _none(count, f"{count} satellites of {len(systems)} systems", last)
    clocks = np.array([[letter == system for system in systems] for letter in letters], dtype=float)
    known = last is not None and last.fix_type == 3 and len(last.clock_m) == len(systems)
    r = last.r_ecef_m if last is not None and known else _somewhere_below(orbits, tow_s)
    clock_m = last.clock_m if last is not None and known else np.zeros(len(systems))
    for _ in range(ROUNDS_MAX):
        seen = sight(orbits, tow_s - clock_m[0] / SPEED_OF_LIGHT_MPS, r, NO_MOTION, atmosphere)
        weights = _weights(seen) if known else np.ones(count)
        model = seen.range_m - SPEED_OF_LIGHT_MPS * seen.clock_s + seen.delay_m + clocks @ clock_m
        design = np.hstack((-seen.toward, clocks))
        step, covariance = _least_squares(design, pseudorange_m - model, weights)
        if step is None:
            return _none(count, "satellites in one plane", last)
        r, clock_m = r + step[:3], clock_m + step[3:]
        size = float(np.max(np.abs(step)))
        if known and size < 10.0:  # the geometry hardly changes any more
            break
        if size < CONVERGED_M:
            known = True
    else:
        return _none(count, "no convergence", last)
    return _finish(seen, r, clock_m, covariance, weights, doppler_mps, last)


def _finish(
    seen: Sight,
    r_ecef_m: Vector,
    clock_m: Vector,
    covariance: Vector,
    weights: Vector,
    doppler_mps: Vector,
    last: Fix | None,
) -> Fix:
    """The fix with its velocity, unless it is too uncertain."""
    lat, lon, _ = geodetic_from_ecef(r_ecef_m)
    axes = rot_en(lat, lon)
    sigma = np.sqrt(np.maximum(np.diag(axes.T @ covariance[:3, :3] @ axes), 0.0))
    if np.hypot(sigma[0], sigma[1]) > EPH_MAX_M:
        return _none(len(doppler_mps), "geometry too poor", last)
    design = np.hstack((-seen.toward, np.ones((len(doppler_mps), 1))))
    rates = doppler_mps - seen.rate_mps + SPEED_OF_LIGHT_MPS * seen.clock_rate
    v, _ = _least_squares(design, rates, weights)
    velocity, drift = (v[:3], float(v[3])) if v is not None else (NO_MOTION, 0.0)
    return Fix(3, len(doppler_mps), r_ecef_m, velocity, clock_m, drift, sigma)


def _least_squares(
    design: Vector, residual: Vector, weights: Vector
) -> tuple[Vector | None, Vector]:
    """The weighted solution and its covariance; None if the design has not full rank."""
    weighted = design * weights[:, None]
    normal = weighted.T @ design
    try:
        covariance = np.linalg.inv(normal)
    except np.linalg.LinAlgError:
        return None, np.empty((0, 0))
    return covariance @ (weighted.T @ residual), np.asarray(covariance, dtype=float)


def _weights(seen: Sight) -> Vector:
    """1/sigma^2 with the usual growth of a pseudorange's error towards the horizon."""
    return np.asarray((np.maximum(np.sin(seen.elevation_rad), 0.05) / RANGE_FLOOR_M) ** 2)


def _somewhere_below(orbits: Orbits, tow_s: float) -> Vector:
    """A place on the Earth's surface amid the satellites, to start from."""
    middle = satellite_states(orbits, np.full(len(orbits.table), tow_s))[0].mean(axis=0)
    return np.asarray(SURFACE_M * middle / np.linalg.norm(middle))


def _none(count: int, reason: str, last: Fix | None) -> Fix:
    """No fix; the place stays the last one."""
    place = last.r_ecef_m if last is not None else np.zeros(3)
    nothing = np.full(3, np.inf)
    return Fix(min(count, 1), count, place, NO_MOTION, np.zeros(0), 0.0, nothing, reason)
