"""Snapshot solution of one epoch: weighted least squares over position, clock and system offset."""

from dataclasses import dataclass

import numpy as np

from analysis.gnss import predict_ranges, satellite_states
from analysis.samples import Epoch, Vector

ITERATIONS = 12
CONVERGED_M = 1e-4
TROPOSPHERE_FROM_M = 5.0e6  # below this radius the first guess is still near the earth's centre


@dataclass(frozen=True, slots=True)
class Fix:
    """A snapshot solution.

    `r_ecef_m` (3,), `clock_m` the receiver clock, `isb_m` Galileo's offset against GPS (0 with one
    system), `residual_m` and `sigma_m` (n,), `design` (n, 4 or 5) the geometry, `cofactor` its
    inverse normal matrix (weights included), `dof` = n - 4 or n - 5, `statistic` the weighted sum
    of squared residuals; `elevation_rad` and `azimuth_rad` (n,).
    """

    satellites: tuple[str, ...]
    r_ecef_m: Vector
    clock_m: float
    isb_m: float
    residual_m: Vector
    sigma_m: Vector
    design: Vector
    cofactor: Vector
    dof: int
    statistic: float
    elevation_rad: Vector
    azimuth_rad: Vector

    @property
    def pdop(self) -> float:
        """Position dilution of precision, unweighted; infinite where geometry fails."""
        normal = self.design.T @ self.design
        try:
            return float(np.sqrt(np.trace(np.linalg.inv(normal)[:3, :3])))
        except np.linalg.LinAlgError:
            return float("inf")


def design_matrix(los: Vector, galileo: Vector) -> Vector:
    """Geometry (n, 4 or 5): minus the unit vectors, the clock, Galileo's offset if mixed."""
    columns = [-los, np.ones((len(los), 1))]
    if galileo.any() and not galileo.all():
        columns.append(galileo[:, None].astype(float))
    return np.hstack(columns)


def solve(
    epoch: Epoch, packed: Vector, ionosphere: Vector, sigma_m: Vector, guess: Vector | None = None
) -> Fix | None:
    """Least squares from raw pseudoranges.

    Parameters
    ----------
    epoch : Epoch
        n satellites, all with an ephemeris.
    packed : (n, 23), `gnss.pack_ephemeris` of each
    ionosphere : (8,), Klobuchar's coefficients
    sigma_m : (n,), one sigma of each pseudorange
    guess : (3,), ECEF in m; the earth's centre by default

    Returns
    -------
    Fix or None
        None where there are too few satellites or their geometry fails.
    """
    states = satellite_states(packed, float(epoch.week), epoch.tow_s, epoch.pseudorange_m)
    galileo = np.array([name[0] == "E" for name in epoch.satellites])
    r = np.zeros(3) if guess is None else guess.copy()
    clock = np.zeros(2)
    for _ in range(ITERATIONS):
        near = float(r @ r) > TROPOSPHERE_FROM_M**2
        predicted = predict_ranges(
            states, r if near else r + 1e-3, np.zeros(3), epoch.tow_s, ionosphere
        )
        design = design_matrix(predicted[:, 2:5], galileo)
        unknowns = design.shape[1]
        if len(design) < unknowns:
            return None
        residual = epoch.pseudorange_m - predicted[:, 0] - design[:, 3:] @ clock[: unknowns - 3]
        weighted = design / sigma_m[:, None]
        try:
            cofactor = np.asarray(np.linalg.inv(weighted.T @ weighted), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        step = cofactor @ (weighted.T @ (residual / sigma_m))
        r = r + step[:3]
        clock[: unknowns - 3] += step[3:]
        if near and float(np.abs(step[:3]).max()) < CONVERGED_M:
            break
    if not np.isfinite(r).all():
        return None
    residual = residual - design @ step
    return Fix(
        satellites=epoch.satellites,
        r_ecef_m=r,
        clock_m=float(clock[0]),
        isb_m=float(clock[1]),
        residual_m=residual,
        sigma_m=sigma_m,
        design=design,
        cofactor=cofactor,
        dof=len(design) - unknowns,
        statistic=float(((residual / sigma_m) ** 2).sum()),
        elevation_rad=predicted[:, 5].copy(),
        azimuth_rad=predicted[:, 6].copy(),
    )
