"""Pseudoranges and Doppler rates of an epoch as factors.

Galileo's offset from the receiver's clock is taken from the detector's filter, which has known it
for longer than the graph remembers.
"""

from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import X_CLOCK, X_DRIFT
from analysis.fdi.measure import Observed, model
from analysis.fusion.config import FusionConfig
from analysis.fusion.factors import sigma1
from analysis.fusion.frame import Frame
from analysis.fusion.weights import weight
from analysis.fusion.window import key
from analysis.gnss import EARTH_RATE_RPS, LIGHT_MPS
from analysis.samples import Vector
from analysis.solve import design_matrix, systems_of

Mask = NDArray[np.bool_]
NO_ARM = np.zeros(3)
LEAST_WEIGHT = 0.02  # less is left out
HUBER = 1.345  # 95 % efficiency for normal noise (Huber 1964)
GEMAN = 3.0


class Ranges:
    """What one epoch measured, corrected by the models at the filter's state x (21,)."""

    def __init__(
        self,
        observed: Observed,
        x: Vector,
        ionosphere: Vector,
        config: FusionConfig,
        detector: DetectorConfig,
    ) -> None:
        modelled = model(observed, x, detector.sigma, ionosphere)
        self.satellites = observed.satellites
        self._states, self._system = observed.states, observed.system
        self._los = -modelled.h[:, :3]
        self.corrected_m = modelled.v_m + x[X_CLOCK] + _geometry_m(self._states, x[:3])
        self.still_mps = modelled.v_mps + x[X_DRIFT] - self._los @ x[3:6]
        self._white_m = np.sqrt(modelled.variance)
        self._sigma_m = config.correlation * self._white_m
        self._sigma_mps = np.sqrt(modelled.rate_variance)
        self._above = modelled.elevation_rad >= np.radians(detector.mask_deg)
        self._config, self._doppler = config, detector.doppler
        self.normalised = modelled.v_m / self._white_m

    def used(self, weights: dict[str, float]) -> Mask:
        """Which (n,) have a weight."""
        enough = [weights.get(name, 0.0) >= LEAST_WEIGHT for name in self.satellites]
        result: Mask = self._above & np.array(enough, dtype=bool)
        return result

    def own_weights(self, excluded: frozenset[str]) -> dict[str, float]:
        """Weights by the residuals at the filter's state, where nothing else judges them."""
        config = self._config
        if not config.decide:
            return dict.fromkeys(self.satellites, 1.0)
        return {
            name: 0.0 if name in excluded else weight(value, config.suspicious, config.hopeless)
            for name, value in zip(self.satellites, self.normalised, strict=True)
        }

    def factors(
        self, used: Mask, epoch: int, frame: Frame, clock_s: float, weights: dict[str, float]
    ) -> dict[str, Any]:
        """Pseudorange factors by satellite, of those with a weight; the graph's clock is counted
        from `clock_s`."""
        pose, clock, nav = key("x", epoch), key("c", epoch), frame.pose
        offset_m = clock_s * LIGHT_MPS
        made = {}
        for i in np.flatnonzero(used).tolist():
            name, state = self.satellites[i], self._states[i]
            made[name] = gtsam.PseudorangeFactorArm(
                pose,
                clock,
                self.corrected_m[i] - offset_m,
                state[:3],
                NO_ARM,
                nav,
                state[6] / LIGHT_MPS,
                self._loss(sigma1(self._sigma_m[i] / weights[name] ** 0.5)),
            )
        return made

    def rates(
        self,
        used: Mask,
        epoch: int,
        frame: Frame,
        drift: float,
        origin: Any,
        weights: dict[str, float],
    ) -> Any:
        """One linear factor of all Doppler rates on velocity and drift, None without any.

        Rates are linear in both, so the factor holds from `origin`, the values zero, on.
        """
        used = used & np.isfinite(self.still_mps)
        if not self._doppler or not used.any():
            return None
        share = np.array([weights[self.satellites[i]] for i in np.flatnonzero(used)])
        count = len(share)
        row = gtsam.JacobianFactor(
            key("v", epoch),
            -self._los[used] @ frame.axes.T,
            key("d", epoch),
            np.full((count, 1), LIGHT_MPS),
            self.still_mps[used] - drift * LIGHT_MPS,
            gtsam.noiseModel.Diagonal.Sigmas(self._sigma_mps[used] / np.sqrt(share)),
        )
        return gtsam.LinearContainerFactor(row, origin)

    def slow_covariance(self, weights: dict[str, float]) -> Vector | None:
        """Covariance (3, 3) in ECEF of what averaging cannot take away; None if undetermined.

        Multipath, ephemeris and atmosphere stay the same for minutes: a bias of `slow` sigmas per
        satellite, which the position follows as the snapshot solution does.
        """
        used = self.used(weights)
        system = self._system[used]
        if used.sum() < 3 + max(len(systems_of(system)), 1):
            return None
        sigma = self._config.slow * self._white_m[used]
        design = design_matrix(self._los[used], system) / sigma[:, None]
        try:
            cofactor = np.asarray(np.linalg.inv(design.T @ design), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        return cofactor[:3, :3]

    def _loss(self, noise: Any) -> Any:
        robust, estimator = self._config.robust, gtsam.noiseModel.mEstimator
        if robust == "huber":
            return gtsam.noiseModel.Robust.Create(estimator.Huber.Create(HUBER), noise)
        if robust == "geman-mcclure":
            return gtsam.noiseModel.Robust.Create(estimator.GemanMcClure.Create(GEMAN), noise)
        return noise


def _geometry_m(states: Vector, r_m: Vector) -> Vector:
    """Distance (n,) with the earth's turn meanwhile, less the satellites' clocks."""
    apart = states[:, :3] - r_m
    turned = (states[:, 0] * r_m[1] - states[:, 1] * r_m[0]) * (EARTH_RATE_RPS / LIGHT_MPS)
    result: Vector = np.sqrt((apart * apart).sum(axis=1)) + turned - states[:, 6]
    return result
