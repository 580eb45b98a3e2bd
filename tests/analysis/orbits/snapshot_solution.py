"""A snapshot solution by weighted least squares, as a reference beside the detector's own start."""

from dataclasses import dataclass

import numpy as np

from analysis.orbits.broadcast import (
    AZIMUTH,
    CLOCK_OF,
    ELEVATION,
    design_matrix,
    predict_ranges,
    satellite_states,
    systems_of,
)
from analysis.samples.sample import Epoch, Vector

ITERATIONS = 12
CONVERGED_M = 1e-4  # far below the noise of code ranges
TROPOSPHERE_FROM_M = 5.0e6  # below this radius the iteration is still near the earth's centre


@dataclass(frozen=True, slots=True)
class Fix:
    """A snapshot solution.

    `r_ecef_m` (3,) position, `clock_m` receiver clock offset, `isb_m` inter-system biases relative
    to the first system in use (order of `broadcast.CLOCK_OF`), `residual_m` and `sigma_m` (n,),
    `design` (n, k) the geometry matrix with k = 3 + systems, `cofactor` (k, k) the covariance
    (inverse of the weighted normal matrix), `dof` = n - k, `statistic` the weighted sum of squared
    residuals; `elevation_rad` and `azimuth_rad` (n,).
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


def solve_position(
    epoch: Epoch, packed: Vector, ionosphere: Vector, sigma_m: Vector, guess: Vector | None = None
) -> Fix | None:
    """Solve for position and clocks from raw pseudoranges by iterated weighted least squares.

    Parameters
    ----------
    epoch : Epoch
        n satellites, all with an ephemeris.
    packed : (n, 25), `broadcast.pack_ephemeris` of each
    ionosphere : (8,), Klobuchar coefficients
    sigma_m : (n,), standard deviation of each pseudorange
    guess : (3,), initial ECEF position in m; the earth's centre by default

    Returns
    -------
    Fix or None
        None with too few satellites or a singular geometry.
    """
    states = satellite_states(packed, float(epoch.week), epoch.tow_s, epoch.pseudorange_m)
    system = np.array([CLOCK_OF[name[0]] for name in epoch.satellites], dtype=np.int64)
    r = np.zeros(3) if guess is None else guess.copy()
    clock = np.zeros(len(systems_of(system)))
    for _ in range(ITERATIONS):
        near = float(r @ r) > TROPOSPHERE_FROM_M**2  # else move by 1 mm: the centre has no latitude
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
    residual = residual - design @ step  # the last step is too small to need another linearisation
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
