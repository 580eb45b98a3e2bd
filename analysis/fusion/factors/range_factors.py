"""Factors of an epoch's pseudoranges and Doppler rates.

Galileo's inter-system bias is taken from the detector's filter, which has estimated it for longer
than the graph's window.
"""

import math
from typing import Any

import gtsam
import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.inertial import X_CLOCK, X_DRIFT, R, V
from analysis.detection.filter.measurement import EpochObservation, compare_with_prediction
from analysis.detection.isolation.epoch_memory import frozen_offsets_m
from analysis.fusion.factors.factor_weights import residual_weight
from analysis.fusion.factors.unary_factors import unit_noise
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.graph_start import ClockState, Node
from analysis.fusion.local_frame import LocalFrame
from analysis.fusion.window import variable_key
from analysis.orbits.broadcast import CLOCK as SAT_CLOCK
from analysis.orbits.broadcast import systems_of
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS, SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.linear import invert_positive_definite

NO_LEVER_ARM = np.zeros(3)
MIN_WEIGHT = 0.02  # smaller weights change nothing: the measurement is left out


class EpochRanges:
    """The measurements of one epoch, corrected by the models at the filter's state x (21,).

    Weights (n,) are in the order of the satellites, 0 where one is left out. The offsets that the
    detector has frozen are subtracted here too, so that both use the same ranges.

    Attributes
    ----------
    satellites, system : tuple of str, array (n,)
    los : array, shape (n, 3)
        Lines of sight.
    corrected_m, rate_mps : arrays, shape (n,)
        Range and rate corrected for delays, satellite clock and satellite motion.
    residual_m : array, shape (n,)
        The range less the distance from the filter's position.
    sigma_m, rate_sigma_mps : arrays, shape (n,)
        In the graph.
    normalised : array, shape (n, 2)
        Innovations of ranges and rates over the detector's sigmas.
    """

    def __init__(
        self,
        observation: EpochObservation,
        x: Vector,
        core: DetectorCore,
        config: FusionConfig,
        detector: DetectorConfig,
        t_us: int,
    ) -> None:
        self.satellites, self._states = observation.satellites, observation.satellite_states
        self.system = observation.measurements.system
        self._config, self._doppler, self._r_m = config, detector.doppler, x[R : R + 3]
        states, measured = self._states, observation.measurements
        offset_m = frozen_offsets_m(core.memory.frozen, self.satellites, t_us, detector)
        seen = compare_with_prediction(
            measured._replace(pseudorange_m=measured.pseudorange_m - offset_m),
            states,
            x,
            core.broadcast.ionosphere,
            detector.sigma,
        )
        self.los = -seen.geometry[:, :3]
        turned = states[:, 0] * x[1] - states[:, 1] * x[0]
        sagnac = turned * GNSS_EARTH_RATE_RPS / SPEED_OF_LIGHT_MPS
        distance = np.linalg.norm(states[:, :3] - x[:3], axis=1) + sagnac - states[:, SAT_CLOCK]
        white, self.rate_sigma_mps = np.sqrt(seen.variance), np.sqrt(seen.rate_variance)
        self.residual_m = seen.range_m + x[X_CLOCK]
        self.corrected_m = self.residual_m + distance
        self.rate_mps = seen.rate_mps + x[X_DRIFT] - self.los @ x[V : V + 3]
        self.sigma_m = config.correlation * white
        self.normalised = np.stack([seen.range_m / white, seen.rate_mps / self.rate_sigma_mps], 1)
        self._above_mask = seen.elevation_rad >= math.radians(detector.mask_deg)

    @property
    def has_rates(self) -> bool:
        """Whether the measurements include rates."""
        return self._doppler and bool(np.isfinite(self.rate_mps).any())

    def weights(self, by_name: dict[str, float]) -> Vector:
        """Weights (n,) from weights by name; 0 below the mask or `MIN_WEIGHT`."""
        weights = np.array([by_name.get(name, 0.0) for name in self.satellites])
        return np.where(self._above_mask & (weights >= MIN_WEIGHT), weights, 0.0)

    def residual_weights(self, excluded: frozenset[str]) -> Vector:
        """Weights from the residuals at the filter's state, for epochs the detector did not
        test."""
        config = self._config
        if not config.decide:
            return self.weights(dict.fromkeys(self.satellites, 1.0))
        normalised = zip(self.satellites, self.normalised[:, 0].tolist(), strict=True)
        return self.weights(
            {
                name: 0.0
                if name in excluded
                else residual_weight(value, config.suspicious, config.hopeless)
                for name, value in normalised
            }
        )

    def factor(
        self,
        node: Node,
        origin: Any,
        frame: LocalFrame,
        clock: ClockState,
        weights: Vector,
        rates_only: bool,
    ) -> Any | None:
        """One factor on pose, velocity and clock of all pseudoranges and rates of an epoch,
        weighted by `weights` (n,); None if there are none.

        The ranges are `PseudorangeFactorArm`s without a lever arm, linearised at the filter's
        position: the error is d^2/2R at a distance d, 2 micrometres at 10 m. The graph's clock is
        relative to `clock`; `origin` holds the initial values of the epoch, pose and velocity those
        of the node.
        """
        pose, used = node.pose.matrix(), weights > 0.0
        of_ranges = np.flatnonzero(used & (not rates_only))
        of_rates = np.flatnonzero(used & self._doppler & np.isfinite(self.rate_mps))
        if not len(of_ranges) + len(of_rates):
            return None
        # The root: information is proportional to the weight.
        share = np.sqrt(weights[of_ranges]) / self.sigma_m[of_ranges]
        rate_share = np.sqrt(weights[of_rates]) / self.rate_sigma_mps[of_rates]
        los = share[:, None] * (self.los[of_ranges] @ frame.axes.T)
        rate_los = rate_share[:, None] * (self.los[of_rates] @ frame.axes.T)
        ahead_m = pose[:3, 3] - frame.local(self._r_m)
        right_side = [
            share * (self.residual_m[of_ranges] - clock[0]) + los @ ahead_m,
            rate_share * (self.rate_mps[of_rates] - clock[1]) + rate_los @ node.velocity,
        ]
        n, rows = len(share), len(share) + len(rate_share)
        by_pose, by_velocity, by_clock = (np.zeros((rows, columns)) for columns in (6, 3, 2))
        by_pose[:n, 3:], by_clock[:n, 0] = -los @ pose[:3, :3], share
        by_velocity[n:], by_clock[n:, 1] = -rate_los, rate_share
        x, v, c = (variable_key(letter, node.epoch) for letter in "xvc")
        row = gtsam.JacobianFactor(
            x, by_pose, v, by_velocity, c, by_clock, np.concatenate(right_side), unit_noise(rows)
        )
        return gtsam.LinearContainerFactor(row, origin)

    def pseudorange(
        self, i: int, pose: int, seconds: int, frame: LocalFrame, clock: ClockState, noise: Any
    ) -> Any:
        """One satellite's factor on a pose and a clock in seconds, two keys."""
        state = self._states[i]
        return gtsam.PseudorangeFactorArm(
            pose,
            seconds,
            # The graph's clock is relative to this, which keeps its variable small.
            self.corrected_m[i] - clock[0],
            state[:3],
            NO_LEVER_ARM,
            frame.pose,
            state[SAT_CLOCK] / SPEED_OF_LIGHT_MPS,
            noise,
        )

    @property
    def unknowns(self) -> int:
        """Number of unknowns of a snapshot solution."""
        return 3 + len(systems_of(self.system))

    def slow_covariance(self, weights: Vector, share: float) -> Vector | None:
        """Covariance (3, 3) in ECEF of the errors that do not average out; None if undetermined.

        Multipath, ephemeris and atmosphere last for minutes: a bias of `share` sigmas per
        satellite, propagated to the position by the snapshot solution.
        """
        used = weights > 0.0
        # Only for systems in use: an unobserved clock would make the matrix singular.
        clocks = self.system[used][:, None] == np.unique(self.system[used])
        # The graph's sigmas include the correlation factor; this needs those of one epoch.
        sigmas = share / self._config.correlation * self.sigma_m[used]
        rows = np.hstack([self.los[used], clocks]) / sigmas[:, None]
        # With fewer satellites than unknowns rounding may still leave the matrix invertible.
        if rows.shape[0] < rows.shape[1]:
            return None
        covariance = invert_positive_definite(rows.T @ rows)[:3, :3]
        return covariance if math.isfinite(covariance[0, 0]) else None
