"""Pseudoranges and Doppler rates of an epoch as factors.

Galileo's offset from the receiver's clock is taken from the detector's filter, which has known it
for longer than the graph remembers.
"""

import math
from typing import Any

import gtsam
import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.measure import Observed, model
from analysis.fusion.beginning import Clock
from analysis.fusion.config import FusionConfig
from analysis.fusion.factors import NUMBER, at_rest, linear_rows, unit
from analysis.fusion.frame import Frame
from analysis.fusion.learnt import Learnt
from analysis.fusion.weights import weight
from analysis.fusion.window import key
from analysis.gnss import EARTH_RATE_RPS, LIGHT_MPS
from analysis.samples import Vector
from analysis.solve import design_matrix, systems_of
from mavproxy_fault.wire.compiled import compiled

Weights = dict[str, float]
NO_ARM = np.zeros(3)
LEAST_WEIGHT = 0.02  # less is left out
# columns of the table of a satellite
CORRECTED, SIGMA, RATE_SIGMA, LOS, NORMALISED = 0, 2, 3, slice(4, 7), 7


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
        self._r_m = x[:3]
        self._table = _corrected(
            observed.states,
            x,
            config.correlation,
            modelled.v_m,
            modelled.v_mps,
            modelled.variance,
            modelled.rate_variance,
            modelled.h,
        )
        self._above = (modelled.elevation_rad >= math.radians(detector.mask_deg)).tolist()
        self._config, self._slow, self._doppler = config, config.slow, detector.doppler

    @property
    def sigma_m(self) -> Vector:
        """Sigmas (n,) of the pseudoranges as the graph takes them."""
        result: Vector = self._table[:, SIGMA]
        return result

    def normalised(self, weights: Weights) -> Vector:
        """Residuals (n, 2) of ranges and rates over their sigmas; NaN where unused."""
        found = np.full((len(self.satellites), 2), np.nan)
        at = self.used(weights)
        found[at] = self._table[at, NORMALISED:]
        return found

    def learn(self, learnt: Learnt) -> None:
        """Take over what is known of sigmas."""
        self._table[:, RATE_SIGMA] *= learnt.rate_factors(self.satellites)
        unknowns = 3 + len(systems_of(self._system))
        self._slow = learnt.slow(self._config.slow, unknowns)

    def used(self, weights: Weights) -> list[int]:
        """Indices of those with a weight."""
        pairs = zip(self.satellites, self._above, strict=True)
        return [
            i
            for i, (name, above) in enumerate(pairs)
            if above and weights.get(name, 0.0) >= LEAST_WEIGHT
        ]

    def own_weights(self, excluded: frozenset[str]) -> Weights:
        """Weights by the residuals at the filter's state, where nothing else judges them."""
        config = self._config
        if not config.decide:
            return dict.fromkeys(self.satellites, 1.0)
        return {
            name: 0.0 if name in excluded else weight(value, config.suspicious, config.hopeless)
            for name, value in zip(self.satellites, self._table[:, NORMALISED], strict=True)
        }

    def factor(
        self, at: list[int], epoch: int, turn: Any, frame: Frame, clock: Clock, weights: Weights
    ) -> Any:
        """All pseudoranges and rates of an epoch in one factor on pose, velocity and clock.

        Linearised at the filter's position, with the rotation `turn` of the body to the frame;
        `clock` is what the graph's is counted from. Ranges bend by d^2/2R over a distance d: by
        2 micrometres over 10 m.
        """
        noise, x = unit(1), key("x", epoch)
        origin = gtsam.Values(at_rest(epoch))
        origin.insert(x, gtsam.Pose3(turn, frame.local(self._r_m)))
        made = [self.pseudorange(i, x, NUMBER, frame, clock, noise) for i in at]
        by_pose, _, wanted = linear_rows(made, origin)
        roots = self._roots(at, weights)
        rows = _whitened(
            self._table[at], roots, frame.axes, clock[1], by_pose, wanted, self._doppler
        )
        return _container(rows, epoch, origin)

    def rates(
        self, at: list[int], epoch: int, frame: Frame, clock: Clock, weights: Weights
    ) -> Any | None:
        """The rates alone, None without any."""
        table, none = self._table[at], np.empty((0, 6))
        roots = self._roots(at, weights)
        rows = _whitened(table, roots, frame.axes, clock[1], none, np.empty(0), self._doppler)
        origin = gtsam.Values(at_rest(epoch))
        origin.insert(key("x", epoch), gtsam.Pose3())
        return _container(rows, epoch, origin) if len(rows) else None

    def pseudorange(
        self, i: int, pose: int, seconds: int, frame: Frame, clock: Clock, noise: Any
    ) -> Any:
        """One satellite's factor on a pose and a clock in seconds, two keys."""
        state = self._states[i]
        return gtsam.PseudorangeFactorArm(
            pose,
            seconds,
            self._table[i, CORRECTED] - clock[0],
            state[:3],
            NO_ARM,
            frame.pose,
            state[6] / LIGHT_MPS,
            noise,
        )

    def _roots(self, at: list[int], weights: Weights) -> Vector:
        """Roots of weights: what a sigma is divided by."""
        return np.sqrt([weights[self.satellites[i]] for i in at])

    def slow_covariance(self, weights: Weights) -> Vector | None:
        """Covariance (3, 3) in ECEF of what averaging cannot take away; None if undetermined.

        Multipath, ephemeris and atmosphere stay the same for minutes: a bias of `slow` sigmas per
        satellite, which the position follows as the snapshot solution does.
        """
        used = self.used(weights)
        system = self._system[used]
        if len(used) < 3 + max(len(systems_of(system)), 1):
            return None
        sigma = self._slow * self.sigma_m[used] / self._config.correlation
        design = design_matrix(self._table[used, LOS], system) / sigma[:, None]
        try:
            cofactor = np.asarray(np.linalg.inv(design.T @ design), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        return cofactor[:3, :3]


def _container(rows: Vector, epoch: int, origin: Any) -> Any:
    """Rows (k, 12) as a factor on an epoch, linearised at some values."""
    x, v, c = (key(letter, epoch) for letter in "xvc")
    row = gtsam.JacobianFactor(
        x, rows[:, :6], v, rows[:, 6:9], c, rows[:, 9:11], rows[:, 11], unit(len(rows))
    )
    return gtsam.LinearContainerFactor(row, origin)


@compiled
def _corrected(
    states: Vector,
    x: Vector,
    correlation: float,
    v_m: Vector,
    v_mps: Vector,
    variance: Vector,
    rate_variance: Vector,
    h: Vector,
) -> Vector:
    """Table (n, 9) of innovations at the state x: range without delays and rate without the
    receiver's motion, their sigmas, line of sight, both innovations normalised."""
    out = np.empty((states.shape[0], 9))
    for i in range(out.shape[0]):
        square, along = 0.0, 0.0
        for k in range(3):
            square += (states[i, k] - x[k]) ** 2
            out[i, 4 + k] = -h[i, k]
            along -= h[i, k] * x[3 + k]
        turned = (states[i, 0] * x[1] - states[i, 1] * x[0]) * (EARTH_RATE_RPS / LIGHT_MPS)
        white = math.sqrt(variance[i])
        out[i, 0] = v_m[i] + x[16] + math.sqrt(square) + turned - states[i, 6]
        out[i, 1] = v_mps[i] + x[17] - along
        out[i, 2], out[i, 3] = correlation * white, math.sqrt(rate_variance[i])
        out[i, 7], out[i, 8] = v_m[i] / white, v_mps[i] / out[i, 3]
    return out


@compiled
def _whitened(
    table: Vector,
    roots: Vector,
    axes: Vector,
    drift_mps: float,
    by_pose: Vector,
    wanted: Vector,
    doppler: bool,
) -> Vector:
    """Rows (k, 12) over their sigmas: pseudoranges where `by_pose` (n, 6) has any, then rates.

    Columns: pose (6), velocity (3), clock, drift, and what they should come to.
    """
    ranges = by_pose.shape[0]
    out = np.zeros((ranges + table.shape[0], 12))
    for i in range(ranges):
        share = roots[i] / table[i, 2]
        for k in range(6):
            out[i, k] = share * by_pose[i, k]
        out[i, 9], out[i, 11] = share, share * wanted[i]
    count = ranges
    for i in range(table.shape[0]):
        if not (doppler and np.isfinite(table[i, 1])):
            continue
        share = roots[i] / table[i, 3]
        for k in range(3):
            for j in range(3):
                out[count, 6 + k] -= share * axes[k, j] * table[i, 4 + j]
        out[count, 10], out[count, 11] = share, share * (table[i, 1] - drift_mps)
        count += 1
    return out[:count]
