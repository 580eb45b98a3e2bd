"""The graph between two restarts: a chain of epochs, the factors on each, the newest estimate."""

from bisect import bisect_left, insort
from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fusion.beginning import Beginning, Clock, Node
from analysis.fusion.config import FusionConfig
from analysis.fusion.edge import Edge, mended, split
from analysis.fusion.factors import EPOCHS, clock_factors, clock_origin
from analysis.fusion.inertia import FREE_TURN_RPS, imagine, imu_params, preintegrate
from analysis.fusion.ranges import Mask, Ranges
from analysis.fusion.window import Window, key
from analysis.samples import ImuSample, Vector

SAME_PLACE_M = 50.0  # gravity turns by 8e-6 rad over it
SAME_US = 1000  # epochs closer than this are one
Attitude = tuple[Any, Vector]  # rotation body to local, covariance (3, 3) in body axes


@dataclass(slots=True)
class Epoch:
    """What the graph remembers of an epoch in the window: `bias` is the block whose biases it has,
    `seen` the pose by vision."""

    t_us: int
    bias: int
    origin: Any
    edge: Edge | None = None
    ranges: Ranges | None = None
    weights: dict[str, float] | None = None
    seen: Any = None


class Graph:
    """Epochs of the last `lag_s` seconds; the older ones live on in their marginal.

    GTSAM's smoother changes in place, so this object does. After `commit`, `node` is the newest
    epoch and `covariance` (9, 9) that of its pose and velocity.
    """

    def __init__(
        self, beginning: Beginning, config: FusionConfig, detector: DetectorConfig
    ) -> None:
        self.frame, self.node = beginning.frame, beginning.node
        self.aligned = beginning.aligned
        self.slow_m2: Vector = np.zeros((3, 3))  # ECEF, what averaging leaves of the position
        self.covariance: Vector = np.zeros((9, 9))
        self.window = Window(config.lag_s)
        self.epochs: dict[int, Epoch] = {}
        self._began = beginning.node
        self._detector = detector
        self._track: list[tuple[int, int]] = []  # times and numbers of epochs, in order of time
        self._count = 0
        self._late: dict[int, list[ImuSample]] = {}
        self._biases: set[int] = set()
        self._params: tuple[Vector, Any] | None = None
        self._insert(self.node)
        self.attach("prior", 0, *beginning.priors(self.bias_key(0)))

    def seconds(self, t_us: int) -> float:
        """Time since the graph began."""
        return (t_us - self._began.t_us) * 1e-6

    def clock_at(self, t_us: int) -> Clock:
        """Clock and drift that the graph's are counted from."""
        clock, drift = self._began.clock
        return clock + drift * self.seconds(t_us), drift

    def attach(self, source: str, epoch: int, *factors: Any, since: int | None = None) -> None:
        """Factors of a source on an epoch (and on the one `since`), for the next `commit`."""
        oldest = self.epochs[epoch if since is None else since]
        self.window.attach(source, epoch, self.seconds(oldest.t_us), *factors)

    def nearest(self, t_us: int, within_us: int) -> int | None:
        """The epoch in the window nearest to a time."""
        at = bisect_left(self._track, (t_us, -1))
        around = self._track[max(at - 1, 0) : at + 1]
        best = min(around, key=lambda entry: abs(entry[0] - t_us))
        return best[1] if abs(best[0] - t_us) <= within_us else None

    def neighbours(self, epoch: int) -> tuple[int | None, int | None]:
        """The epochs before and after one."""
        at = bisect_left(self._track, (self.epochs[epoch].t_us, epoch))
        before = self._track[at - 1][1] if at > 0 else None
        after = self._track[at + 1][1] if at + 1 < len(self._track) else None
        return before, after

    def begins_block(self) -> bool:
        """Whether the newest epoch is the first of its block."""
        before, _ = self.neighbours(self.node.epoch)
        return before is not None and self.epochs[before].bias != self.epochs[self.node.epoch].bias

    def extend(self, t_us: int, edge: Edge, attitude: Attitude | None = None) -> bool:
        """One epoch more after the newest, with its attitude where that becomes known.

        Returns whether the IMU ties it to the one before.
        """
        old = self.node
        if attitude is not None:
            edge = replace(edge, trusted=False, turn_rps=FREE_TURN_RPS)
        elif not self.aligned:
            edge = replace(edge, trusted=False)
        motion = self._motion(edge, old, t_us)
        self.node = self._new_node(old, t_us, motion)
        if attitude is not None:
            pose = gtsam.Pose3(attitude[0], self.node.pose.translation())
            self.node = replace(self.node, pose=pose)
        self._insert(self.node)
        self._tie(edge, motion, self.node.epoch)
        if attitude is not None:
            self.aligned = True
            noise = gtsam.noiseModel.Gaussian.Covariance(attitude[1])
            x = key("x", self.node.epoch)
            prior = gtsam.PoseRotationPrior3D(x, attitude[0], noise)
            self.attach("aligned", self.node.epoch, prior)
        return edge.sound(self._detector.gap_s)

    def insert_late(self, t_us: int) -> Node | None:
        """An epoch between two of the window; None where there is no place for it."""
        at = bisect_left(self._track, (t_us, -1))
        if not 0 < at < len(self._track):
            return None
        (start_us, i), (end_us, j) = self._track[at - 1], self._track[at]
        edge = self.epochs[j].edge
        if edge is None or min(t_us - start_us, end_us - t_us) < SAME_US:
            return None
        first, second = split(edge.part, start_us, t_us, end_us)
        earlier = replace(edge, part=first)
        start = self.estimate(i)
        motion = self._motion(earlier, start, t_us)
        node = self._new_node(start, t_us, motion)
        self._insert(node)
        self._tie(earlier, motion, node.epoch)
        self._retie(j, replace(edge, before=node.epoch, part=second), node)
        return node

    def hear_late(self, sample: ImuSample) -> None:
        """An IMU sample from between two epochs of the window: it is used at the next commit."""
        at = bisect_left(self._track, (sample.t_us, -1))
        if 0 < at < len(self._track):
            self._late.setdefault(self._track[at][1], []).append(sample)

    def distrust(self, since_us: int) -> None:
        """Take back the IMU from a time on."""
        for t_us, epoch in self._track:
            edge = self._edge(epoch)
            if t_us > since_us and edge is not None and edge.trusted:
                self._retie(epoch, replace(edge, trusted=False))

    def attach_ranges(self, epoch: int, ranges: Ranges, weights: dict[str, float]) -> list[str]:
        """The pseudoranges and rates of an epoch; the satellites used."""
        at = self.epochs[epoch]
        at.ranges, at.weights = ranges, weights
        clock_s, _ = self.clock_at(at.t_us)
        used = ranges.used(weights)
        made = ranges.factors(used, epoch, self.frame, clock_s, weights)
        for name, factor in made.items():
            self.attach(name, epoch, factor)
        self._attach_rates(used, epoch, at)
        return list(made)

    def _attach_rates(self, used: Mask, epoch: int, at: Epoch) -> None:
        assert at.ranges is not None
        assert at.weights is not None
        origin = gtsam.Values(at.origin)
        origin.insert(key("v", epoch), np.zeros(3))
        _, drift = self._began.clock
        rates = at.ranges.rates(used, epoch, self.frame, drift, origin, at.weights)
        if rates is not None:
            self.attach("rates", epoch, rates)

    def remove(self, name: str, since_us: int) -> None:
        """Take back a satellite from a time on."""
        for t_us, epoch in self._track:
            at = self.epochs[epoch]
            if t_us < since_us or not self.window.take_back(name, epoch):
                continue
            at.weights = {**(at.weights or {}), name: 0.0}
            if self.window.take_back("rates", epoch):
                assert at.ranges is not None
                self._attach_rates(at.ranges.used(at.weights), epoch, at)

    def estimate(self, epoch: int) -> Node:
        """What the smoother thinks of an epoch since the last commit.

        Raises
        ------
        RuntimeError
            If it is not finite.
        """
        smoother, t_us = self.window.smoother, self.epochs[epoch].t_us
        pose = smoother.calculateEstimatePose3(key("x", epoch))
        velocity = np.asarray(smoother.calculateEstimateVector(key("v", epoch)))
        clock = smoother.calculateEstimateDouble(key("c", epoch))
        drift = float(smoother.calculateEstimateVector(key("d", epoch))[0])
        if not (np.isfinite(pose.matrix()).all() and np.isfinite([*velocity, clock, drift]).all()):
            raise RuntimeError("the estimate is not finite")
        bias = smoother.calculateEstimateConstantBias(self.bias_key(epoch))
        known = self.clock_at(t_us)
        return Node(epoch, t_us, pose, velocity, bias, (known[0] + clock, known[1] + drift))

    def bias_key(self, epoch: int) -> int:
        """The biases at an epoch."""
        return key("b", self.epochs[epoch].bias)

    def commit(self) -> None:
        """Solve with what was attached and take over the estimate.

        Raises
        ------
        RuntimeError
            By GTSAM, when the system cannot be solved; or when the estimate is not finite.
        """
        for epoch, late in self._late.items():
            edge = self._edge(epoch)
            if edge is not None and edge.trusted:
                start_us, end_us = self.epochs[edge.before].t_us, self.epochs[epoch].t_us
                part = mended(edge.part, start_us, end_us, late)
                self._retie(epoch, replace(edge, part=part))
        self._late = {}
        self._forget()
        self.window.commit()
        epoch = self.node.epoch
        self.node = self.estimate(epoch)
        self.covariance = self.window.covariance([key("x", epoch), key("v", epoch)])

    def _edge(self, epoch: int) -> Edge | None:
        """The edge to an epoch if it can still be changed: it and both ends are in the window."""
        at = self.epochs.get(epoch)
        if at is None or at.edge is None or not self.window.slots("imu", epoch):
            return None
        return at.edge if at.edge.before in self.epochs else None

    def _forget(self) -> None:
        """Epochs that the next commit marginalises."""
        oldest_s, stamp = self.window.oldest_s, self.window.stamp
        while self._track and stamp(self.seconds(self._track[0][0])) < oldest_s:
            _, epoch = self._track.pop(0)
            del self.epochs[epoch]
        self._biases = {block for block in self._biases if self.window.starts_s(block) >= oldest_s}

    def _new_node(self, start: Node, t_us: int, motion: Any) -> Node:
        guess = motion.predict(gtsam.NavState(start.pose, start.velocity), start.bias)
        self._count = (self._count + 1) % EPOCHS
        if self._count in self.epochs:
            raise RuntimeError(f"more than {EPOCHS} epochs in the window")
        drift = start.clock[1]
        clock = start.clock[0] + drift * (t_us - start.t_us) * 1e-6, drift
        return Node(self._count, t_us, guess.pose(), guess.velocity(), start.bias, clock)

    def _insert(self, node: Node) -> None:
        origin, t_s = clock_origin(node.epoch), self.seconds(node.t_us)
        values = gtsam.Values(origin)
        names = [key(letter, node.epoch) for letter in "xvcd"]
        values.insert(names[0], node.pose)
        values.insert(names[1], node.velocity)
        block = self.window.block(t_s)
        if block not in self._biases:
            self._biases.add(block)
            names.append(key("b", block))
            values.insert(names[-1], node.bias)
        self.window.insert(values, names, t_s)
        self.epochs[node.epoch] = Epoch(node.t_us, block, origin)
        insort(self._track, (node.t_us, node.epoch))

    def _motion(self, edge: Edge, start: Node, t_us: int) -> Any:
        """The preintegrated IMU of an edge, or a model of motion in its place."""
        noise = self._detector.noise
        walking = self.epochs[edge.before].bias != self.window.block(self.seconds(t_us))
        if edge.sound(self._detector.gap_s):
            r_m = start.pose.translation()
            if self._params is None or np.abs(r_m - self._params[0]).max() > SAME_PLACE_M:
                self._params = r_m, imu_params(self.frame, r_m, noise)
            return preintegrate(edge.part.samples, start.bias, self._params[1], walking)
        dt_s = (t_us - start.t_us) * 1e-6
        return imagine(dt_s, start.bias, self.frame, noise, edge.turn_rps, walking)

    def _tie(self, edge: Edge, motion: Any, epoch: int) -> None:
        i, j = edge.before, epoch
        before, after = self.epochs[i], self.epochs[j]
        after.edge = edge
        (x0, v0), (x1, v1) = ([key(letter, at) for letter in "xv"] for at in (i, j))
        b0, b1 = key("b", before.bias), key("b", after.bias)
        if b0 == b1:
            moved: Any = gtsam.ImuFactor(x0, v0, x1, v1, b0, motion)
        else:
            moved = gtsam.CombinedImuFactor(x0, v0, x1, v1, b0, b1, motion)
        self.attach("imu", j, moved, since=i)
        origin = gtsam.Values(before.origin)
        origin.insert(after.origin)
        dt_s = (after.t_us - before.t_us) * 1e-6
        rows = clock_factors(i, j, origin, dt_s, edge.jumped_s, self._detector)
        self.attach("clock", j, *rows, since=i)

    def _retie(self, epoch: int, edge: Edge, start: Node | None = None) -> None:
        """Another edge to an epoch in place of the one it has."""
        for source in ("imu", "clock"):
            self.window.take_back(source, epoch)
        start = start or self.estimate(edge.before)
        self._tie(edge, self._motion(edge, start, self.epochs[epoch].t_us), epoch)
