"""The factor graph between two restarts: a chain of epochs, their factors, the newest estimate."""

from bisect import bisect_left, insort
from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.fusion.factors.imu_factors import (
    FREE_RATE_RPS,
    imu_params,
    motion_model,
    preintegrate_imu,
)
from analysis.fusion.factors.range_factors import EpochRanges
from analysis.fusion.factors.robust_factors import clock_seconds_factor, pseudorange_factors
from analysis.fusion.factors.unary_factors import MAX_EPOCHS, clock_factor
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.graph_start import ClockState, GraphStart, Node, first_guess
from analysis.fusion.imu_edge import Edge, add_late_samples, split_segment
from analysis.fusion.window import FactorWindow, variable_key
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector

SAME_EPOCH_US = 1000  # epochs closer than this are one: far below any epoch interval
RANGES = "ranges"
Attitude = tuple[Any, Vector]  # rotation body to local, covariance (3, 3) in body axes


@dataclass(slots=True)
class GraphEpoch:
    """An epoch in the window: its initial value as a node and as GTSAM's values, its stamp in the
    window, the edge to it, its ranges with weights, and its pose by vision."""

    first: Node
    values: Any
    stamp_s: float
    edge: Edge | None = None
    ranges: EpochRanges | None = None
    weights: Vector = field(default_factory=lambda: np.empty(0))
    vision_pose: Any = None

    @property
    def t_us(self) -> int:
        """The epoch's time."""
        return self.first.t_us


class Graph:
    """Epochs of the last `lag_s` seconds; older ones are marginalised into a prior.

    GTSAM's smoother changes in place, so this object does. After `commit`, `node` is the newest
    epoch and `covariance` (9, 9) that of its pose and velocity.
    """

    def __init__(
        self, beginning: GraphStart, config: FusionConfig, detector: DetectorConfig
    ) -> None:
        self.frame, self.node = beginning.frame, beginning.node
        self.aligned = beginning.aligned
        self.spans: dict[str, list[int]] = {"h": [], "w": []}  # of the slow states, by letter
        self.slow_m2: Vector = np.zeros((3, 3))  # ECEF, covariance of the lasting position error
        self.covariance: Vector = np.zeros((9, 9))
        self.window = FactorWindow(config.lag_s, any_scale=beginning.uncertain)
        self.epochs: dict[int, GraphEpoch] = {}
        self._began = beginning.node
        self._detector = detector
        self._track: list[tuple[int, int]] = []  # times and numbers of epochs, in order of time
        self._free: list[int] = []  # numbers of marginalised epochs, for reuse
        self._late_imu: dict[int, list[tuple[int, Vector]]] = {}
        self._robust = config.robust
        self._insert(self.node)
        self.attach("prior", 0, *beginning.priors())

    def seconds(self, t_us: int) -> float:
        """Time since the graph began."""
        return (t_us - self._began.t_us) * 1e-6

    def clock_at(self, t_us: int) -> ClockState:
        """Reference clock in m and drift in m/s, relative to which the graph's variables are."""
        clock, drift = self._began.clock
        return clock + drift * self.seconds(t_us), drift

    def attach(self, source: str, epoch: int, *factors: Any, since: int | None = None) -> None:
        """Add factors of a source on an epoch (and on the one `since`) at the next `commit`."""
        oldest = self.epochs[epoch if since is None else since]
        self.window.attach(source, epoch, oldest.stamp_s, *factors)

    def nearest(self, t_us: int, within_us: int) -> int | None:
        """The epoch in the window nearest to a time, None if none is within `within_us`."""
        at = bisect_left(self._track, (t_us, -1))
        around = self._track[max(at - 1, 0) : at + 1]
        best = min(around, key=lambda entry: abs(entry[0] - t_us))
        return best[1] if abs(best[0] - t_us) <= within_us else None

    def pose(self, epoch: int) -> Any:
        """The newest estimate of an epoch's pose."""
        return (self.node if epoch == self.node.epoch else self.estimate(epoch)).pose

    def vision_neighbours(self, epoch: int, within_us: int) -> tuple[int | None, int | None]:
        """The nearest epochs with a vision pose before and after one."""
        t_us = self.epochs[epoch].t_us
        seen = [(at, i) for at, i in self._track if self.epochs[i].vision_pose is not None]
        before = [i for at, i in seen if 0 < t_us - at <= within_us]
        after = [i for at, i in seen if 0 < at - t_us <= within_us]
        return (before[-1] if before else None), (after[0] if after else None)

    def begins_span(self) -> bool:
        """Whether the newest epoch is the first of its span of the window."""
        newest = [self.span(epoch) for _, epoch in self._track[-2:]]
        return len(newest) == 2 and newest[0] != newest[1]

    def span(self, epoch: int) -> int:
        """The span of the window that contains an epoch."""
        return self.window.span(self.seconds(self.epochs[epoch].t_us))

    def extend(self, t_us: int, edge: Edge, attitude: Attitude | None = None) -> bool:
        """Append an epoch after the newest, with its attitude if that becomes known.

        Returns whether the IMU connects it to the previous one.
        """
        old = self.node
        if attitude is not None:
            # The attitude jumps here from unknown to known: the IMU must not connect the two.
            edge = edge._replace(trusted=False, rate_sigma_rps=FREE_RATE_RPS)
        elif not self.aligned:
            edge = edge._replace(trusted=False)
        motion = self._motion(edge, old, t_us)
        self.node = self._new_node(old, t_us, motion)
        if attitude is not None:
            pose = gtsam.Pose3(attitude[0], self.node.pose.translation())
            self.node = self.node._replace(pose=pose)
        self._insert(self.node)
        self._connect(edge, motion, self.node.epoch)
        if attitude is not None:
            self.aligned = True
            noise = gtsam.noiseModel.Gaussian.Covariance(attitude[1])
            x = variable_key("x", self.node.epoch)
            prior = gtsam.PoseRotationPrior3D(x, attitude[0], noise)
            self.attach("aligned", self.node.epoch, prior)
        return self.uses_imu(edge)

    def uses_imu(self, edge: Edge) -> bool:
        """Whether the IMU connects the ends of an edge."""
        return edge.uses_imu(self._detector.gap_s)

    def insert_late(self, t_us: int) -> Node | None:
        """Insert an epoch between two of the window; None if there is no place for it."""
        at = bisect_left(self._track, (t_us, -1))
        if not 0 < at < len(self._track):
            return None
        (start_us, i), (end_us, j) = self._track[at - 1], self._track[at]
        edge = self.epochs[j].edge
        # Two epochs as close as this would be duplicates.
        if edge is None or min(t_us - start_us, end_us - t_us) < SAME_EPOCH_US:
            return None
        first, second = split_segment(edge.part, start_us, t_us, end_us)
        earlier = edge._replace(part=first)
        start = self.estimate(i)
        motion = self._motion(earlier, start, t_us)
        node = self._new_node(start, t_us, motion)
        self._insert(node)
        self._connect(earlier, motion, node.epoch)
        # The edge that spanned the gap now begins at the new epoch.
        self._reconnect(j, edge._replace(before=node.epoch, part=second), node)
        return node

    def add_late_imu(self, t_us: int, rates_force: Vector) -> None:
        """Add a late IMU sample (6,) between two epochs of the window; the next commit uses it."""
        at = bisect_left(self._track, (t_us, -1))
        if 0 < at < len(self._track):
            self._late_imu.setdefault(self._track[at][1], []).append((t_us, rates_force))

    def drop_imu_since(self, since_us: int) -> None:
        """Remove the IMU's factors from the given time onward."""
        for t_us, epoch in self._track:
            edge = self._edge(epoch)
            if t_us > since_us and edge is not None and edge.trusted:
                self._reconnect(epoch, edge._replace(trusted=False))

    def attach_ranges(self, epoch: int, ranges: EpochRanges, weights: Vector) -> None:
        """Attach the pseudoranges and rates of an epoch with their weights (n,)."""
        at = self.epochs[epoch]
        at.ranges, at.weights = ranges, weights
        clock, alone = self.clock_at(at.t_us), self._robust == "none"
        rows = ranges.factor(at.first, at.values, self.frame, clock, weights, rates_only=not alone)
        if alone:
            if rows is not None:
                self.attach(RANGES, epoch, rows)
            return
        if not weights.any():
            return
        factors = pseudorange_factors(ranges, weights, epoch, self.frame, clock, self._robust)
        for name, factor in factors.items():
            self.attach(name, epoch, factor)
        initial, tie = clock_seconds_factor(epoch)
        self.window.insert(initial, (variable_key("r", epoch),), at.stamp_s)
        self.attach(RANGES, epoch, tie, *([] if rows is None else [rows]))

    def remove_satellite(self, name: str, since_us: int) -> None:
        """Remove a satellite from a time on: the other ranges of each epoch are attached again."""
        for t_us, epoch in self._track:
            at = self.epochs[epoch]
            if t_us < since_us or at.ranges is None or name not in at.ranges.satellites:
                continue
            i = at.ranges.satellites.index(name)
            # A satellite of weight 0 has no row in the factor.
            if at.weights[i] > 0.0 and self.window.remove(RANGES, epoch):
                others = at.weights.copy()
                others[i] = 0.0
                self.attach_ranges(epoch, at.ranges, others)

    def estimate(self, epoch: int) -> Node:
        """The smoother's estimate of an epoch at the last commit.

        Raises
        ------
        RuntimeError
            If the estimate is not finite.
        """
        smoother, t_us = self.window.smoother, self.epochs[epoch].t_us
        pose = smoother.calculateEstimatePose3(variable_key("x", epoch))
        velocity = smoother.calculateEstimateVector(variable_key("v", epoch))
        clock = smoother.calculateEstimateVector(variable_key("c", epoch))
        if not all(np.isfinite(one).all() for one in (pose.matrix(), velocity, clock)):
            raise RuntimeError("the estimate is not finite")
        bias = smoother.calculateEstimateConstantBias(variable_key("b", epoch))
        known, (clock_m, drift_mps) = self.clock_at(t_us), clock.tolist()
        return Node(epoch, t_us, pose, velocity, bias, (known[0] + clock_m, known[1] + drift_mps))

    def commit(self) -> None:
        """Solve with the attached factors and update the estimate.

        Raises
        ------
        RuntimeError
            From GTSAM, if the system cannot be solved; or if the estimate is not finite.
        """
        for epoch, late in self._late_imu.items():
            edge = self._edge(epoch)
            if edge is not None and edge.trusted:
                start_us, end_us = self.epochs[edge.before].t_us, self.epochs[epoch].t_us
                run = ImuRun(*map(np.array, zip(*late, strict=True)))
                part = add_late_samples(edge.part, start_us, end_us, run)
                self._reconnect(epoch, edge._replace(part=part))
        self._late_imu = {}
        # Before solving, since the smoother drops these variables in the update.
        self._drop_marginalised()
        self.window.commit()
        epoch = self.node.epoch
        self.node = self.estimate(epoch)
        self.covariance = self.window.covariance(
            [variable_key("x", epoch), variable_key("v", epoch)]
        )

    def _edge(self, epoch: int) -> Edge | None:
        """The edge to an epoch if it can still be changed: edge and both ends are in the window."""
        at = self.epochs.get(epoch)
        if at is None or at.edge is None or not self.window.slots("imu", epoch):
            return None
        return at.edge if at.edge.before in self.epochs else None

    def _drop_marginalised(self) -> None:
        """Drop the epochs that the next commit marginalises."""
        oldest_s = self.window.oldest_s
        while self._track and self.epochs[self._track[0][1]].stamp_s < oldest_s:
            _, epoch = self._track.pop(0)
            del self.epochs[epoch]
            self._free.append(epoch)

    def _new_node(self, start: Node, t_us: int, motion: Any) -> Node:
        predicted = motion.predict(gtsam.NavState(start.pose, start.velocity), start.bias)
        # Numbers are reused: keys and cached factors are per number.
        epoch = self._free.pop() if self._free else len(self.epochs)
        if epoch == MAX_EPOCHS:
            raise RuntimeError(f"more than {MAX_EPOCHS} epochs in the window")
        drift = start.clock[1]
        clock = start.clock[0] + drift * (t_us - start.t_us) * 1e-6, drift
        return Node(epoch, t_us, predicted.pose(), predicted.velocity(), start.bias, clock)

    def _insert(self, node: Node) -> None:
        values = first_guess(node)
        names = [variable_key(letter, node.epoch) for letter in "xvbc"]
        stamp_s = self.window.stamp(self.seconds(node.t_us))
        self.window.insert(values, names, stamp_s)
        self.epochs[node.epoch] = GraphEpoch(node, values, stamp_s)
        insort(self._track, (node.t_us, node.epoch))

    def _motion(self, edge: Edge, start: Node, t_us: int) -> Any:
        """The preintegrated IMU of an edge, or the motion model in its place."""
        if self.uses_imu(edge):
            params = imu_params(self.frame, start.pose.translation(), edge.noise)
            return preintegrate_imu(edge.part.samples, start.bias, params)
        dt_s = (t_us - start.t_us) * 1e-6
        return motion_model(dt_s, start.bias, self.frame, edge.noise, edge.rate_sigma_rps)

    def _connect(self, edge: Edge, motion: Any, epoch: int) -> None:
        before, after = self.epochs[edge.before], self.epochs[epoch]
        after.edge = edge
        (x0, v0, b0), (x1, v1, b1) = (
            [variable_key(letter, at) for letter in "xvb"] for at in (edge.before, epoch)
        )
        imu = gtsam.CombinedImuFactor(x0, v0, x1, v1, b0, b1, motion)
        self.attach("imu", epoch, imu, since=edge.before)
        dt_s = (after.t_us - before.t_us) * 1e-6
        clock = clock_factor(edge.before, epoch, dt_s, edge.clock_jump_m, self._detector.noise)
        self.attach("clock", epoch, clock, since=edge.before)

    def _reconnect(self, epoch: int, edge: Edge, start: Node | None = None) -> None:
        """Replace the edge to an epoch."""
        for source in ("imu", "clock"):
            self.window.remove(source, epoch)
        start = start or self.estimate(edge.before)
        self._connect(edge, self._motion(edge, start, self.epochs[epoch].t_us), epoch)
