"""The fusion step: samples and the detector's verdicts in, a fused state per GNSS epoch out."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.core import Core
from analysis.fdi.measure import observe
from analysis.fdi.motion import Segment, keep_pending, segment, split_pending
from analysis.fdi.ranges import FREE_CLOCK_M
from analysis.fdi.state import Motion, Pending
from analysis.fusion.config import FusionConfig
from analysis.fusion.factors import Ranges
from analysis.fusion.graph import Graph, clock_of
from analysis.fusion.inertia import imagine, preintegrate
from analysis.fusion.other import WAITING, attach_others
from analysis.fusion.weights import isolated_sensors, range_weights
from analysis.gnss import LIGHT_MPS
from analysis.results import Decision, FusedState, Result
from analysis.samples import Epoch, ImuSample, Sample, Vector
from simvehicle.rotation import quat_from_matrix

LOOSE_M = 10.0  # a start less sure than this takes the epoch's own ranges in
NOTHING: Vector = np.empty(0)


@dataclass(frozen=True, slots=True)
class FusionState:
    """IMU samples and others that wait for the next epoch, the graph (which changes in place),
    satellites left out at the last epoch, the last result and how often the graph began."""

    pending: Pending | None = None
    waiting: dict[str, Sample] = field(default_factory=dict)
    graph: Graph | None = None
    excluded: frozenset[str] = frozenset()
    last: FusedState | None = None
    vision: Any = None


@dataclass(frozen=True)
class Fusion:
    """Smooths what the detector finds healthy; noise and masks are the detector's."""

    config: FusionConfig = field(default_factory=FusionConfig)
    detector: DetectorConfig = field(default_factory=DetectorConfig)

    def new_state(self) -> FusionState:
        """Nothing known."""
        return FusionState()

    def step(
        self, sample: Sample, results: Sequence[Result], core: Core, state: FusionState
    ) -> tuple[list[Result], FusionState]:
        """The fused state at an epoch, and the next state.

        Parameters
        ----------
        sample : Sample
        results : sequence of Result
            What the detector and the tests of other sensors said of this sample.
        core : Core
            The detector's state after it: where the graph begins, and the orbits in use.
        state : FusionState
        """
        if type(sample) is ImuSample:
            return [], self._with_imu(sample, core, state)
        kind = WAITING.get(type(sample))
        if kind is not None:
            state = replace(state, waiting={**state.waiting, kind: sample})
        decision = next((result for result in results if isinstance(result, Decision)), None)
        if decision is None or (state.graph and decision.t_us <= state.graph.node.t_us):
            return [], state
        try:
            return self._epoch(sample, decision, results, core, state)
        except (RuntimeError, ValueError, IndexError) as error:
            return self._failed(str(error).strip().splitlines()[0], decision, core, state)

    def _with_imu(self, sample: ImuSample, core: Core, state: FusionState) -> FusionState:
        pending = state.pending
        if core.imu_id not in (None, sample.id):
            return state
        if pending is not None and sample.t_us <= pending.sample.t_us:
            return state
        return replace(state, pending=keep_pending(sample, pending))

    def _epoch(
        self,
        sample: Sample,
        decision: Decision,
        results: Sequence[Result],
        core: Core,
        state: FusionState,
    ) -> tuple[list[Result], FusionState]:
        motion = core.motion if core.motion and core.motion.t_us == decision.t_us else None
        weights = range_weights(decision, self.config)
        ranges = self._ranges(sample, motion, core)
        run, pending = split_pending(state.pending, decision.t_us)
        state = replace(state, pending=pending)
        graph, used = state.graph, {}
        if graph is not None and self._must_restart(graph, decision, motion):
            graph = None
        isolated = isolated_sensors(results, self.config)
        if graph is None:
            if motion is None:
                return [], state
            graph = Graph(motion, self.config, self.detector)
            used["imu"] = float(motion.inertial)
            if state.graph is not None:
                graph.slow_m2 = state.graph.slow_m2
            if ranges and np.sqrt(motion.p[0, 0]) > LOOSE_M:
                used |= self._attach(graph, ranges, weights)
            state = replace(state, graph=graph, vision=None)
        else:
            used["imu"] = self._extend(graph, decision, motion, run, isolated)
            if ranges:
                used |= self._attach(graph, ranges, weights)
            vision, others = attach_others(
                graph, decision, state.waiting, state.vision, isolated, self.config
            )
            used |= others
            state = replace(state, vision=vision)
        graph.commit()
        excluded = frozenset(decision.excluded) if self.config.decide else frozenset()
        onsets = {
            name: core.excluded[name].onset_us
            for name in excluded - state.excluded
            if name in core.excluded
        }
        graph.remove(onsets)
        used |= dict.fromkeys(excluded, 0.0)
        said = fused_state(graph, used, "the graph began" if graph.node.epoch == 0 else "")
        return [said], replace(state, waiting={}, excluded=excluded, last=said)

    def _must_restart(self, graph: Graph, decision: Decision, motion: Motion | None) -> bool:
        """Where the detector began anew, or found or lost its attitude; after a long silence."""
        silent_s = (decision.t_us - graph.node.t_us) * 1e-6
        if decision.mode == "start" or silent_s > self.detector.reset_s:
            return True
        return motion is not None and motion.inertial != graph.inertial

    def _ranges(self, sample: Sample, motion: Motion | None, core: Core) -> Ranges | None:
        if not isinstance(sample, Epoch) or motion is None or core.chosen is None:
            return None
        observed = observe(sample, core.chosen)
        if observed is None:
            return None
        return Ranges(observed, motion.x, core.ionosphere, self.config, self.detector)

    def _attach(self, graph: Graph, ranges: Ranges, weights: dict[str, float]) -> dict[str, float]:
        made = ranges.factors(graph.node.epoch, graph.frame, weights)
        for name, factors in made.items():
            graph.attach(name, *factors)
        slow = ranges.slow_covariance(weights)
        if slow is not None:
            graph.slow_m2 = slow
        return {name: weights[name] for name in made}

    def _extend(
        self,
        graph: Graph,
        decision: Decision,
        motion: Motion | None,
        run: list[ImuSample],
        isolated: set[str],
    ) -> float:
        """The next epoch, by the IMU if it is there and sound; its weight."""
        node = graph.node
        part: Segment = segment(run, Motion(node.t_us, NOTHING, NOTHING), decision.t_us)
        sound = graph.inertial and part.heard and part.gap_s <= self.detector.gap_s
        noise = self.detector.noise
        if sound and "imu" not in isolated:
            r_m = node.pose.translation()
            moved = preintegrate(part.samples, node.bias, graph.frame, r_m, noise)
        else:
            sound = False
            dt_s = (decision.t_us - node.t_us) * 1e-6
            moved = imagine(dt_s, node.bias, graph.frame, noise)
        clock = clock_of(motion) if motion is not None else None
        jumped = FREE_CLOCK_M / LIGHT_MPS if decision.hypothesis == "clock" else 0.0
        graph.extend(decision.t_us, moved, clock, jumped)
        return float(sound)

    def _failed(
        self, why: str, decision: Decision, core: Core, state: FusionState
    ) -> tuple[list[Result], FusionState]:
        """Report it and begin anew where the detector is; else stay silent until it knows."""
        reason = f"the graph failed ({why}) and began anew"
        state = replace(state, graph=None, waiting={}, vision=None, excluded=frozenset())
        motion = core.motion
        if motion is not None and motion.t_us == decision.t_us:
            try:
                graph = Graph(motion, self.config, self.detector)
                graph.commit()
                said = fused_state(graph, {}, reason)
            except (RuntimeError, ValueError, IndexError):
                pass  # the next epoch tries again
            else:
                return [said], replace(state, graph=graph, last=said)
        if state.last is None:
            return [], state
        last = state.last
        return [
            FusedState(
                t_s=decision.t_us * 1e-6,
                t_us=decision.t_us,
                position_ecef_m=last.position_ecef_m,
                velocity_ned_mps=last.velocity_ned_mps,
                q_nb=last.q_nb,
                position_sigma_m=last.position_sigma_m,
                velocity_sigma_mps=last.velocity_sigma_mps,
                attitude_sigma_deg=last.attitude_sigma_deg,
                reason=f"the graph failed ({why}); this is the last good state",
            )
        ], state


def fused_state(graph: Graph, weights: dict[str, float], reason: str) -> FusedState:
    """The newest epoch in words; sigmas of position and velocity north, east, down, those of
    attitude about the body's axes."""
    node = graph.node
    r_m = node.pose.translation()
    rot = node.pose.rotation().matrix()
    to_ned = graph.frame.ned_from_local(r_m)
    pose, velocity = graph.covariances()
    body = to_ned @ rot
    to_ned_ecef = to_ned @ graph.frame.axes
    position = body @ pose[3:, 3:] @ body.T + to_ned_ecef @ graph.slow_m2 @ to_ned_ecef.T
    speed = to_ned @ velocity @ to_ned.T
    turn = np.degrees(np.sqrt(np.diag(pose)[:3]))
    return FusedState(
        t_s=node.t_us * 1e-6,
        t_us=node.t_us,
        position_ecef_m=_triple(graph.frame.ecef(r_m)),
        velocity_ned_mps=_triple(to_ned @ node.velocity),
        q_nb=tuple(quat_from_matrix(body).tolist()),
        position_sigma_m=_triple(np.sqrt(np.diag(position))),
        velocity_sigma_mps=_triple(np.sqrt(np.diag(speed))),
        attitude_sigma_deg=_triple(turn),
        weights=weights,
        reason=reason,
    )


def _triple(values: Vector) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
