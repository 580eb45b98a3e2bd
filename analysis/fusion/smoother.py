"""The fusion step: samples and the detector's results in, a fused state per GNSS epoch out."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace as with_fields

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.filter_config import ProcessNoise
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import X_ISB
from analysis.detection.filter.measurement import observe
from analysis.detection.filter.propagation import ImuSegment
from analysis.fusion.factors.factor_weights import (
    faulty_rates,
    isolated_sensors,
    range_weights,
    sensor_weights,
)
from analysis.fusion.factors.gnc import find_outliers
from analysis.fusion.factors.range_factors import EpochRanges
from analysis.fusion.factors.sensor_factors import SOURCE_NAMES, SensorFactors
from analysis.fusion.filter_check import blend_with_filter, filter_contradiction
from analysis.fusion.fused_record import fused_state
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.fusion_state import FusionEpoch, FusionState
from analysis.fusion.graph import Attitude, Graph
from analysis.fusion.graph_start import (
    attitude_in_frame,
    navigation_state,
    start_from_filter,
)
from analysis.fusion.imu_edge import Edge, segment_between
from analysis.results import Decision, FusedState, Result, SensorDecision
from analysis.samples.block import ATTITUDE, IMU, TRUTH, BlockSlice
from analysis.samples.sample import Epoch, Sample

GOOD_ATTITUDE_RAD = 0.1  # with a smaller sigma the attitude needs no help from the detector
IMU_SUSPECT_SHARE = 0.5  # of the threshold: an isolated IMU's factors are removed from here on
NOISE_HYPOTHESES = ("none", "satellites")  # under which residuals are noise
CLOCK_JUMP_M = 1e5  # sigma of a jump that the detector reported: leaves the clock to the ranges
IN_ROWS = IMU, TRUTH, ATTITUDE  # kinds of samples that are used in runs, or not at all
SOLVER_ERRORS = (RuntimeError, ValueError, IndexError)  # raised by GTSAM and numpy


@dataclass(frozen=True)
class Fusion:
    """Smoother over the measurements that the detector did not exclude, with its noise."""

    config: FusionConfig = field(default_factory=FusionConfig)
    detector: DetectorConfig = field(default_factory=DetectorConfig)
    name: str = "fused"

    def new_state(self) -> FusionState:
        """The fusion's state before the first sample."""
        return FusionState()

    def step(
        self, piece: BlockSlice, results: Sequence[Result], core: DetectorCore, state: FusionState
    ) -> tuple[list[Result], FusionState]:
        """The fused states of samples up to an event, and the next state, which is changed in
        place; `results` and `core` are the detector's at the event."""
        state.add_imu(piece.imu if core.imu.id is None else piece.of_imu(core.imu.id))
        states: list[Result] = []
        kinds = piece.block.kind[piece.first : piece.last + 1]
        # The others are processed singly.
        for row in (piece.first + np.flatnonzero(~np.isin(kinds, IN_ROWS))).tolist():
            of_row = results if row == piece.last else ()
            fused, state = self._step_sample(piece.block.sample(row), of_row, core, state)
            states += fused
        return states, state

    def _step_sample(
        self, sample: Sample, results: Sequence[Result], core: DetectorCore, state: FusionState
    ) -> tuple[list[Result], FusionState]:
        """Process one sample; returns the fused state at an epoch, and the next state."""
        decision = next((result for result in results if isinstance(result, Decision)), None)
        graph, source = state.graph, SOURCE_NAMES.get(type(sample))
        # Older than the newest node: it belongs between older ones.
        if graph is not None and sample.t_us < graph.node.t_us:
            self._attach_late(graph, sample, source, core, state)
            return [], state
        if source is not None:
            state.pending[source] = sample
        if decision is None or (graph is not None and decision.t_us <= graph.node.t_us):
            return [], state
        now = FusionEpoch(sample, decision, results, core)
        try:
            fused = self._next_epoch(now, state)
        except SOLVER_ERRORS as error:
            fused = self._recover(now, state, _first_line(error))
        # Also without a fused state: the next epoch begins after this one.
        state.drop_imu_until(decision.t_us)
        if fused is None:
            return [], state
        if self.config.decide:
            if _unbounded(sample, decision):
                return [], state
            fused = blend_with_filter(fused, decision, _tied(fused, state))
        state.last = fused
        return [fused], state

    def _next_epoch(self, now: FusionEpoch, state: FusionState) -> FusedState | None:
        """The next epoch of the graph, or the first of a new one."""
        graph, motion = state.graph, now.motion
        if now.core.motion is None:  # the detector has no position, so there is none to fuse
            state.graph = None
            return None
        # It starts again with the detector, and after a gap that is too long.
        if (
            graph is not None
            and now.decision.mode != "start"
            and (now.decision.t_us - graph.node.t_us) * 1e-6 <= self.detector.reset_s
        ):
            return self._continue(graph, now, state)
        if motion is None:
            return None
        state.notes.append("the graph started")
        return self._begin(motion, now, state)

    def _begin(self, motion: MotionEstimate, now: FusionEpoch, state: FusionState) -> FusedState:
        """Start a new graph at the detector's solution."""
        beginning = start_from_filter(motion, self.config.correlation)
        before, graph = state.graph, Graph(beginning, self.config, self.detector)
        state.graph, state.attitude_lost = graph, False
        # The satellites are the same, and so are their lasting errors.
        if before is not None:
            graph.slow_m2 = before.slow_m2
        used = {"imu": float(motion.inertial)}
        if beginning.uncertain:
            used |= self._attach_ranges(graph, now, state)
        return self._commit(graph, used, now, state)

    def _continue(self, graph: Graph, now: FusionEpoch, state: FusionState) -> FusedState | None:
        """Append one epoch to the graph."""
        isolated = isolated_sensors(now.results, self.config)
        attitude = self._update_imu_trust(graph, now, isolated, state)
        t_us, node = now.decision.t_us, graph.node
        part = segment_between(state.imu_until(t_us), node.t_us, t_us)
        silent = part.gap_s > self.detector.gap_s  # missing samples may still arrive
        trusted = silent or not ("imu" in isolated or state.attitude_lost)
        jumped_m = CLOCK_JUMP_M if now.decision.hypothesis == "clock" else 0.0
        edge = Edge(node.epoch, part, self._imu_noise(part, trusted, state), trusted, jumped_m)
        connected = graph.extend(t_us, edge, attitude)
        # Once the IMU was missing the attitude is uncertain until `_update_imu_trust` finds it
        # known again.
        state.attitude_lost = state.attitude_lost or (
            graph.aligned and not connected and attitude is None
        )
        used = {"imu": float(connected)} | self._attach_ranges(graph, now, state)
        sensors = SensorFactors(graph, self.config)
        tested = sensor_weights(now.results, isolated, self.config) if state.pending else {}
        for source, sample in state.pending.items():
            share = sensors.attach(sample, now.decision, tested.get(source, 1.0))
            if share is not None:
                used[source] = share
        state.isolated = isolated
        fused = self._commit(graph, used, now, state)
        contradiction = filter_contradiction(graph, now.motion, self.config.correlation)
        if contradiction and self.config.decide:
            assert now.motion is not None
            state.notes = [f"{contradiction}; it was restarted there"]
            return self._begin(now.motion, now, state)
        return fused if any(used.values()) else None  # without any source there is no fused state

    def _imu_noise(self, part: ImuSegment, trusted: bool, state: FusionState) -> ProcessNoise:
        if not self.config.learn:
            return self.detector.noise
        if trusted:
            state.noise.add_imu(part.samples)
        return state.noise.current_noise(self.detector.noise)

    def _commit(
        self, graph: Graph, used: dict[str, float], now: FusionEpoch, state: FusionState
    ) -> FusedState:
        """Remove what was found faulty since the last epoch, solve, and build the fused state."""
        excluded = frozenset(now.decision.excluded) if self.config.decide else frozenset()
        # Only new ones: the others were removed when they were excluded.
        for name in excluded - state.excluded:
            if name in now.core.trust.excluded:
                graph.remove_satellite(name, now.core.trust.excluded[name].onset_us)
        graph.commit()
        if self.config.robust == "gnc" and graph.begins_span():
            self._drop_outliers(graph)
        state.excluded = excluded
        weights = used | dict.fromkeys(sorted(excluded), 0.0)
        fused = fused_state(graph, self.name, weights, "; ".join(state.notes))
        state.pending, state.notes = {}, []
        return fused

    @staticmethod
    def _drop_outliers(graph: Graph) -> None:
        known = [at.ranges.satellites for at in graph.epochs.values() if at.ranges]
        outliers = find_outliers(graph.window, frozenset(name for names in known for name in names))
        for name, epoch in outliers:
            graph.window.remove(name, epoch)
        if outliers:
            graph.commit()

    def _update_imu_trust(
        self, graph: Graph, now: FusionEpoch, isolated: frozenset[str], state: FusionState
    ) -> Attitude | None:
        """If the IMU is isolated, remove its factors since it became suspicious.

        Afterwards the graph continues without it until its own attitude or the detector's is good
        enough; returns the detector's attitude where that is better.
        """
        node = graph.node
        tests = [r for r in now.results if isinstance(r, SensorDecision) and r.sensor == "imu"]
        for test in tests:
            limit = IMU_SUSPECT_SHARE * (test.threshold or 0.0)
            nominal = test.statistic is None or test.statistic <= limit
            since_us = node.t_us if state.imu_suspect_us is None else state.imu_suspect_us
            state.imu_suspect_us = None if nominal else since_us
        if "imu" in isolated:
            if "imu" not in state.isolated and state.imu_suspect_us is not None:
                graph.drop_imu_since(state.imu_suspect_us)
            return None
        motion = now.motion
        if motion is None or not motion.inertial:
            suspended = self.config.decide and now.core.imu.suspended_until_us is not None
            if not suspended and np.trace(graph.covariance[:3, :3]) < 3.0 * GOOD_ATTITUDE_RAD**2:
                state.attitude_lost = False
            return None
        if graph.aligned and not state.attitude_lost:
            return None
        state.attitude_lost = False
        rotation, p = attitude_in_frame(graph.frame, motion)
        # Only a better attitude is used: a worse one would degrade the graph.
        if graph.aligned and np.trace(p) >= np.trace(graph.covariance[:3, :3]):
            return None
        return rotation, p

    def _attach_ranges(
        self, graph: Graph, now: FusionEpoch, state: FusionState
    ) -> dict[str, float]:
        """Attach the epoch's ranges; returns the weights of those used."""
        if not isinstance(now.sample, Epoch) or now.motion is None:
            return {}
        observation, _ = observe(now.sample, now.core.broadcast, self.detector)
        if observation is None:
            return {}
        core, config, decision, noise = now.core, self.config, now.decision, state.noise
        if config.decide:
            observation = observation.without_rates(faulty_rates(now.results))
        ranges = EpochRanges(observation, now.motion.x, core, config, self.detector, decision.t_us)
        weights = ranges.weights(range_weights(decision, config))
        if config.learn:
            if decision.hypothesis in NOISE_HYPOTHESES:
                noise.add_ranges(decision.t_us, ranges.satellites, weights, ranges.normalised)
            noise.scale_rates(ranges.satellites, ranges.rate_sigma_mps)
        graph.attach_ranges(graph.node.epoch, ranges, weights)
        given = zip(ranges.satellites, weights.tolist(), strict=True)
        used = {name: weight for name, weight in given if weight > 0.0}
        share = noise.lasting_share(config.slow, ranges.unknowns) if config.learn else config.slow
        slow = ranges.slow_covariance(weights, share)
        if slow is not None:
            graph.slow_m2 = slow
        return used

    def _attach_late(
        self,
        graph: Graph,
        sample: Sample,
        source: str | None,
        core: DetectorCore,
        state: FusionState,
    ) -> None:
        """Attach a sample that is older than the newest epoch."""
        try:
            if isinstance(sample, Epoch):
                self._late_epoch(graph, sample, core, state)
            elif source is not None and source not in state.isolated:
                SensorFactors(graph, self.config).attach(sample, None)
        except SOLVER_ERRORS as error:
            state.graph = None
            state.notes.append(f"the graph failed ({_first_line(error)})")

    def _late_epoch(
        self, graph: Graph, sample: Epoch, core: DetectorCore, state: FusionState
    ) -> None:
        """Attach late ranges: the detector cannot test them, so their residuals give the
        weights."""
        observation, _ = observe(sample, core.broadcast, self.detector)
        if observation is None or core.motion is None:
            return
        node = graph.insert_late(sample.t_us)
        if node is None:
            return
        x = navigation_state(graph.frame, node, core.motion.x[X_ISB:])
        ranges = EpochRanges(observation, x, core, self.config, self.detector, sample.t_us)
        if self.config.learn:
            state.noise.scale_rates(ranges.satellites, ranges.rate_sigma_mps)
        weights = ranges.residual_weights(state.excluded)
        graph.attach_ranges(node.epoch, ranges, weights)
        graph.commit()
        late_s = (graph.node.t_us - sample.t_us) * 1e-6
        state.notes.append(f"an epoch came {late_s:.2f} s late and was inserted")

    def _recover(self, now: FusionEpoch, state: FusionState, why: str) -> FusedState | None:
        """After a solver failure use the filter's solution if it tested the epoch; otherwise, or if
        that fails too, repeat the last state until the next epoch."""
        state.notes = [f"the graph failed ({why}) and was restarted"]
        if now.motion is not None and now.decision.position_ecef_m is not None:
            with suppress(*SOLVER_ERRORS):
                return self._begin(now.motion, now, state)
        state.graph, state.notes = None, []
        if state.last is None:
            return None
        reason, t_us = f"the graph failed ({why}); this is the last state", now.decision.t_us
        return with_fields(state.last, t_us=t_us, weights={}, reason=reason)  # nothing was used


def _unbounded(sample: Sample, decision: Decision) -> bool:
    """Whether the filter follows ranges without a bound on their errors, as the fusion would."""
    placed = decision.position_ecef_m is not None
    return isinstance(sample, Epoch) and placed and decision.position_sigma_m is None


def _tied(fused: FusedState, state: FusionState) -> bool:
    """Whether IMU, Doppler or another sensor measured the motion since the last epoch."""
    graph = state.graph
    ranges = graph.epochs[graph.node.epoch].ranges if graph is not None else None
    if ranges is None or ranges.has_rates:
        return True
    return any(
        share > 0.0 and name not in ranges.satellites for name, share in fused.weights.items()
    )


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0]
