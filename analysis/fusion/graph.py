"""The graph between two restarts: variables per epoch, factors by source, the smoother.

GTSAM's smoother changes in place, so this object does; `smoother` holds it as its state. QR, since
clocks in seconds are too badly scaled for Cholesky.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import (
    BA,
    BG,
    CLOCK,
    DRIFT,
    PSI,
    X_BA,
    X_BG,
    X_CLOCK,
    X_DRIFT,
    X_Q,
    R,
    V,
    matrix,
)
from analysis.fdi.state import Motion
from analysis.fusion.config import FusionConfig
from analysis.fusion.factors import clock_factors, key, linear, sigma1
from analysis.fusion.frame import Frame, frame_at
from analysis.gnss import LIGHT_MPS
from analysis.samples import Vector

Clock = tuple[float, float]  # clock in s, drift in s/s


@dataclass(frozen=True, slots=True)
class Node:
    """The newest epoch: its number, time and estimate."""

    epoch: int
    t_us: int
    pose: Any
    velocity: Vector
    bias: Any
    clock: Clock


def clock_of(motion: Motion) -> Clock:
    """The clock of the detector's filter, in seconds."""
    x = motion.x
    return x[X_CLOCK] / LIGHT_MPS, x[X_DRIFT] / LIGHT_MPS


class Graph:
    """Epochs of the last `lag_s` seconds; the older ones live on in their marginal."""

    def __init__(self, motion: Motion, config: FusionConfig, detector: DetectorConfig) -> None:
        self.frame: Frame = frame_at(motion.x[R : R + 3])
        self.inertial = motion.inertial
        self._config, self._detector = config, detector
        params = gtsam.ISAM2Params()
        params.setFactorization("QR")
        params.findUnusedFactorSlots = True
        params.relinearizeSkip = 1
        self._smoother = gtsam.IncrementalFixedLagSmoother(config.lag_s, params)
        self._entries: deque[tuple[int, str, list[int]]] = deque()
        self._slow: dict[str, tuple[int, Any]] = {}
        self._zero_us = motion.t_us
        self.dt_s = 0.0
        self.slow_m2: Vector = np.zeros((3, 3))  # ECEF, what averaging leaves of the position
        self._clear()
        rot = self.frame.axes @ matrix(motion.x[X_Q : X_Q + 4])
        pose = gtsam.Pose3(gtsam.Rot3(rot), np.zeros(3))
        bias = gtsam.imuBias.ConstantBias(motion.x[X_BA : X_BA + 3], motion.x[X_BG : X_BG + 3])
        velocity = self.frame.axes @ motion.x[V : V + 3]
        self.node = Node(0, motion.t_us, pose, velocity, bias, clock_of(motion))
        self._insert()
        self._priors(motion, rot)

    def _clear(self) -> None:
        self._batch = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()
        self._stamps: dict[Any, Any] = {}
        self._named: list[tuple[str, int]] = []

    def _stamp(self, name: int) -> None:
        self._stamps[name] = (self.node.t_us - self._zero_us) * 1e-6

    def _insert(self) -> None:
        """The newest node's variables."""
        node = self.node
        clock, drift = node.clock
        for letter, value in (
            ("x", node.pose),
            ("v", node.velocity),
            ("b", node.bias),
            ("c", clock),
            ("d", drift),
        ):
            name = key(letter, node.epoch)
            self._values.insert(name, value)
            self._stamp(name)

    def _priors(self, motion: Motion, rot: Vector) -> None:
        """The detector's filter as the beginning: GTSAM's pose errors are in body axes."""
        p, frame, node = motion.p, self.frame, self.node
        to_body = rot.T @ frame.axes
        both = np.zeros((6, 6))
        both[:3, :3] = both[3:, 3:] = to_body
        spots = [*range(PSI, PSI + 3), *range(R, R + 3)]
        widen = np.diag([1.0] * 3 + [self._config.correlation] * 3)
        pose = widen @ both @ p[np.ix_(spots, spots)] @ both.T @ widen
        speed = frame.axes @ p[V : V + 3, V : V + 3] @ frame.axes.T
        spots = [*range(BA, BA + 3), *range(BG, BG + 3)]
        gaussian = gtsam.noiseModel.Gaussian.Covariance
        tiny = 1e-12
        self.attach(
            "prior",
            gtsam.PriorFactorPose3(key("x", 0), node.pose, gaussian(pose + tiny * np.eye(6))),
        )
        self.attach(
            "prior",
            gtsam.PriorFactorPoint3(key("v", 0), node.velocity, gaussian(speed + tiny * np.eye(3))),
        )
        self.attach(
            "prior",
            gtsam.PriorFactorConstantBias(
                key("b", 0), node.bias, gaussian(p[np.ix_(spots, spots)] + tiny * np.eye(6))
            ),
        )
        for letter, at, value in zip("cd", (CLOCK, DRIFT), node.clock, strict=True):
            sigma = self._config.correlation * np.sqrt(p[at, at] + 1e-4) / LIGHT_MPS
            self.attach("prior", gtsam.PriorFactorDouble(key(letter, 0), value, sigma1(sigma)))

    def attach(self, source: str, *factors: Any) -> None:
        """Factors of a source on the newest epoch, for the next `commit`."""
        for factor in factors:
            self._batch.push_back(factor)
        self._named.append((source, len(factors)))

    def extend(self, t_us: int, preintegrated: Any, clock: Clock | None, jumped_s: float) -> None:
        """One epoch more; its first guess is predicted, that of the clock given where known."""
        old = self.node
        self.dt_s = dt_s = (t_us - old.t_us) * 1e-6
        guess = preintegrated.predict(gtsam.NavState(old.pose, old.velocity), old.bias)
        before = old.clock
        clock = clock or (before[0] + dt_s * before[1], before[1])
        self.node = Node(old.epoch + 1, t_us, guess.pose(), guess.velocity(), old.bias, clock)
        self._insert()
        i, j = old.epoch, self.node.epoch
        moved = gtsam.CombinedImuFactor(
            key("x", i),
            key("v", i),
            key("x", j),
            key("v", j),
            key("b", i),
            key("b", j),
            preintegrated,
        )
        self.attach("imu", moved)
        self.attach("clock", *clock_factors(i, j, dt_s, jumped_s, self._detector))

    def slow(self, letter: str, first: Any, sigma: float, walk: float) -> Any:
        """A source's slow state at the newest epoch, walking since its last; its first guess.

        A number for the barometer's offset, a vector (3,) for the wind. It begins anew when it
        was not there within the lag.
        """
        epoch = self.node.epoch
        name = key(letter, epoch)
        known = self._slow.get(letter)
        scalar = isinstance(first, float)
        if known is None or known[0] != epoch - 1:
            value = first
            prior = gtsam.PriorFactorDouble if scalar else gtsam.PriorFactorPoint3
            noise = gtsam.noiseModel.Isotropic.Sigma(1 if scalar else 3, sigma)
            self.attach(letter, prior(name, value, noise))
        else:
            value, before = known[1], key(letter, known[0])
            if scalar:
                self.attach(letter, linear([(name, 1.0), (before, -1.0)], walk))
            else:
                noise = gtsam.noiseModel.Isotropic.Sigma(3, walk)
                self.attach(letter, gtsam.BetweenFactorPoint3(before, name, np.zeros(3), noise))
        self._values.insert(name, value)
        self._stamp(name)
        self._slow[letter] = (epoch, value)
        return value

    def commit(self) -> None:
        """Solve with what was attached and take over the estimate.

        Raises
        ------
        RuntimeError
            By GTSAM, when the system cannot be solved; or when the estimate is not finite.
        """
        smoother = self._smoother
        smoother.update(self._batch, self._values, self._stamps)
        indices = list(smoother.getISAM2Result().getNewFactorsIndices())
        start = 0
        for source, count in self._named:
            self._entries.append((self.node.t_us, source, indices[start : start + count]))
            start += count
        # Slots of marginalised factors are used again: forget an index before that happens.
        oldest_us = self.node.t_us - round(self._config.lag_s * 0.95e6)
        while self._entries and self._entries[0][0] < oldest_us:
            self._entries.popleft()
        self._clear()
        self._take()

    def remove(self, since_us: dict[str, int]) -> int:
        """Take back the factors of sources from a time on; how many there were."""
        taken = [entry for entry in self._entries if entry[0] >= since_us.get(entry[1], 1 << 62)]
        indices = [index for entry in taken for index in entry[2]]
        if not indices:
            return 0
        for entry in taken:
            self._entries.remove(entry)
        empty = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._smoother.update(*empty, {}, indices)
        self._smoother.update()  # the first only takes them out
        self._take()
        return len(indices)

    def _take(self) -> None:
        smoother, node = self._smoother, self.node
        epoch = node.epoch
        pose = smoother.calculateEstimatePose3(key("x", epoch))
        velocity = np.asarray(smoother.calculateEstimateVector(key("v", epoch)))
        clock, drift = (smoother.calculateEstimateDouble(key(letter, epoch)) for letter in "cd")
        if not (np.isfinite(pose.matrix()).all() and np.isfinite([*velocity, clock]).all()):
            raise RuntimeError("the estimate is not finite")
        bias = smoother.calculateEstimateConstantBias(key("b", epoch))
        self.node = Node(epoch, node.t_us, pose, velocity, bias, (clock, drift))
        for letter, (last, value) in self._slow.items():
            if last == epoch:
                read = (
                    smoother.calculateEstimateDouble
                    if isinstance(value, float)
                    else smoother.calculateEstimateVector
                )
                self._slow[letter] = (epoch, read(key(letter, epoch)))

    def covariances(self) -> tuple[Vector, Vector]:
        """Of the newest pose (6, 6), turn then shift in body axes, and velocity (3, 3)."""
        epoch = self.node.epoch
        return (
            self._smoother.marginalCovariance(key("x", epoch)),
            self._smoother.marginalCovariance(key("v", epoch)),
        )
