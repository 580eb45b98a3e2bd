"""Snapshot solution of one epoch: least squares over position, clock and system offsets."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.orbits.broadcast import (
    AZIMUTH,
    CLOCK_OF,
    ELEVATION,
    predict_ranges,
    satellite_states,
)
from analysis.samples.sample import Epoch, Vector

Indices = NDArray[np.int64]
ITERATIONS = 12
CONVERGED_M = 1e-4
TROPOSPHERE_FROM_M = 5.0e6  # below this radius the first guess is still near the earth's centre


@dataclass(frozen=True, slots=True)
class Fix:
    """A snapshot solution.

    `r_ecef_m` (3,), `clock_m` the receiver clock, `isb_m` the other systems' offsets against the
    first of `broadcast.CLOCK_OF` that is there, `residual_m` and `sigma_m` (n,), `design` (n, k)
    the geometry with k = 3 + systems, `cofactor` its inverse normal matrix (weights included),
    `dof` = n - k, `statistic` the weighted sum of squared residuals; `elevation_rad` and
    `azimuth_rad` (n,).
    """

    satellites: tuple[str, ...]
    r_ecef_m: Vector
    clock_m: float
    isb_m: Vector
    residual_m: Vector
    sigma_m: Vector
    design: Vector
    cofactor: Vector
    dof: int
    statistic: float
    elevation_rad: Vector
    azimuth_rad: Vector


def systems_of(system: Indices) -> list[int]:
    """The systems among `system` (n,), places by `broadcast.CLOCK_OF`; the first has no offset."""
    return sorted(set(system.tolist()))


def design_matrix(los: Vector, system: Indices) -> Vector:
    """Geometry (n, 3 + systems): minus the unit vectors, the clock, the other systems' offsets."""
    columns = [-los, np.ones((len(los), 1))]
    columns += [(system == kind)[:, None].astype(float) for kind in systems_of(system)[1:]]
    return np.hstack(columns)


def solve_position(
    epoch: Epoch, packed: Vector, ionosphere: Vector, sigma_m: Vector, guess: Vector | None = None
) -> Fix | None:
    """Least squares from raw pseudoranges.

    Parameters
    ----------
    epoch : Epoch
        n satellites, all with an ephemeris.
    packed : (n, 25), `gnss.pack_ephemeris` of each
    ionosphere : (8,), Klobuchar's coefficients
    sigma_m : (n,), one sigma of each pseudorange
    guess : (3,), ECEF in m; the earth's centre by default

    Returns
    -------
    Fix or None
        None where there are too few satellites or their geometry fails.
    """
    states = satellite_states(packed, float(epoch.week), epoch.tow_s, epoch.pseudorange_m)
    system = np.array([CLOCK_OF[name[0]] for name in epoch.satellites], dtype=np.int64)
    r = np.zeros(3) if guess is None else guess.copy()
    clock = np.zeros(len(systems_of(system)))
    for _ in range(ITERATIONS):
        near = float(r @ r) > TROPOSPHERE_FROM_M**2  # else 1 mm off: the centre has no latitude
        predicted = predict_ranges(
            states, r if near else r + 1e-3, np.zeros(3), epoch.tow_s, ionosphere
        )
        design = design_matrix(predicted[:, 2:5], system)
        unknowns = design.shape[1]
        if len(design) < unknowns:
            return None
        residual = epoch.pseudorange_m - predicted[:, 0] - design[:, 3:] @ clock
        weighted = design / sigma_m[:, None]
        try:
            cofactor = np.asarray(np.linalg.inv(weighted.T @ weighted), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        step = cofactor @ (weighted.T @ (residual / sigma_m))
        r = r + step[:3]
        clock += step[3:]
        if near and float(np.abs(step[:3]).max()) < CONVERGED_M:
            break
    if not np.isfinite(r).all():
        return None
    residual = residual - design @ step  # the last step is too small to linearise anew
    return Fix(
        satellites=epoch.satellites,
        r_ecef_m=r,
        clock_m=float(clock[0]),
        isb_m=clock[1:],
        residual_m=residual,
        sigma_m=sigma_m,
        design=design,
        cofactor=cofactor,
        dof=len(design) - unknowns,
        statistic=float(((residual / sigma_m) ** 2).sum()),
        elevation_rad=predicted[:, ELEVATION].copy(),
        azimuth_rad=predicted[:, AZIMUTH].copy(),
    )
