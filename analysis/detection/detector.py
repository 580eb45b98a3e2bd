"""The detector: samples in, a decision for each GNSS epoch out."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import (
    DetectorCore,
    DetectorState,
    EpochRecord,
    EpochTiming,
)
from analysis.detection.filter.ephemerides import BroadcastData, unusable_reason
from analysis.detection.filter.measurement import EpochObservation, observe
from analysis.detection.filter.propagation import add_pending, split_pending, update_interval_s
from analysis.detection.isolation.epoch_memory import NOTHING_FROZEN
from analysis.detection.isolation.exclusion import Exclusions, add_exclusions
from analysis.detection.isolation.range_difference import compare_ranges
from analysis.detection.isolation.trust import CONFIRMING_EPOCHS, LEAST_START_DOF
from analysis.detection.stages.clock_drift import clock_results
from analysis.detection.stages.decision_record import (
    build_decision,
    build_start_decision,
    imu_results,
    rate_results,
    untestable_decision,
)
from analysis.detection.stages.ephemeris_fault import (
    try_other_ephemerides,
    with_orbits_compared,
    with_wrong_ephemerides,
)
from analysis.detection.stages.epoch_stages import late_onsets, repair, run_stages
from analysis.detection.stages.initial_fix import check_against_prior, solve_initial_fix
from analysis.detection.stages.receiver_fix import step_position
from analysis.results import Decision, Result
from analysis.samples.block import EPOCH, FIX, Block, BlockSlice, ImuRun, block_of, split_at_events
from analysis.samples.sample import EphemerisSample, Epoch, GpsFix, IonosphereSample, Sample, Vector

State = TypeVar("State")
BRIDGED_SPACINGS = 2.5  # epochs that may be missing at the rate they come, whatever `reset_s`
SPACING_JITTER = 0.2  # of a gap: a smaller change is jitter, not a new rate
SPACING_MAX_US = 120_000_000  # after a longer gap the filter knows nothing of the motion
# Broadcast coefficients leave a fifth of the delay, typical ones about half of it.
TYPICAL_IONOSPHERE_FACTOR = 2.5


class EventDetector(Generic[State]):
    """A detector that processes samples event by event."""

    def step_piece(self, piece: BlockSlice, state: State) -> tuple[list[Result], State]:
        """The results of samples up to an event, and the next state."""
        raise NotImplementedError

    def step(self, samples: Sample | Block, state: State) -> tuple[list[Result], State]:
        """The results of a block of samples, or of a single one, and the next state."""
        results: list[Result] = []
        for piece in split_at_events(samples):
            more, state = self.step_piece(piece, state)
            results += more
        return results, state


@dataclass(frozen=True)
class Detector(EventDetector[DetectorState]):
    """Finds which satellites are faulty, or whether the IMU or the receiver is; see docs/fdi.md."""

    config: DetectorConfig = field(default_factory=DetectorConfig)

    def new_state(self) -> DetectorState:
        """Nothing known."""
        is_typical = self.config.ionosphere == DetectorConfig().ionosphere
        factor = TYPICAL_IONOSPHERE_FACTOR if is_typical else 1.0
        ionosphere = np.array([*self.config.ionosphere, factor], dtype=float)
        return DetectorState(DetectorCore(None, BroadcastData({}, ionosphere)))

    def step_piece(
        self, piece: BlockSlice, state: DetectorState
    ) -> tuple[list[Result], DetectorState]:
        """The decisions on samples up to an event, and the next state."""
        core, pending, mag_b = state
        if len(piece.ids):
            number = core.imu.id
            if number is None:
                # The first IMU in the data stays the one that is used.
                number = int(piece.ids[0])
                core = core._replace(imu=core.imu._replace(id=number))
            pending = add_pending(piece.of_imu(number), pending)
        if piece.mag >= 0:
            # A copy: the block's memory is not kept alive for one row.
            mag_b = piece.block.values[piece.mag, :3].copy()
        state = DetectorState(core, pending, mag_b)
        if piece.kind == FIX and self.wants_fix(core, piece.t_us):
            fix = piece.event
            assert isinstance(fix, GpsFix)
            return step_position(fix, state, self.config)
        # Samples of other kinds are no event of the detector's.
        if piece.kind < EPOCH:
            return [], state
        event, broadcast = piece.event, core.broadcast
        if isinstance(event, Epoch):
            results, core, pending = self._epoch(event, core, pending, mag_b)
            chosen = core.broadcast.selection
            if chosen is not None and chosen is not broadcast.selection and chosen.differences_m:
                results = [
                    with_orbits_compared(r, chosen) if isinstance(r, Decision) else r
                    for r in results
                ]
            return results, DetectorState(core, pending, mag_b)
        if isinstance(event, (EphemerisSample, IonosphereSample)):
            broadcast = broadcast.add(event)
        return [], DetectorState(core._replace(broadcast=broadcast), pending, mag_b)

    def wants_fix(self, core: DetectorCore, t_us: int) -> bool:
        """Whether there are no raw ranges, so that a receiver's own position is needed."""
        ranges_us = core.timing.ranges_us
        return ranges_us is None or t_us - ranges_us >= self._reset_us(core.timing)

    def _reset_us(self, timing: EpochTiming) -> float:
        """The longest gap of epochs that the filter bridges; some epochs come every 30 s."""
        return max(self.config.reset_s * 1e6, BRIDGED_SPACINGS * timing.spacing_us)

    def _epoch(
        self,
        epoch: Epoch,
        core: DetectorCore,
        pending: ImuRun,
        mag_b: Vector | None,
    ) -> tuple[list[Result], DetectorCore, ImuRun]:
        """The decisions on an epoch, the core after it, and the IMU's samples still pending."""
        before, excluded = core, core.trust.excluded
        observation, broadcast = observe(epoch, core.broadcast, self.config)
        core = core._replace(broadcast=broadcast)
        if observation is None:
            reason = unusable_reason(epoch, broadcast.ephemerides)
            return [untestable_decision(epoch.t_us, reason, excluded)], before, pending
        core, reason = self._continue(core, epoch.t_us)
        if reason:
            return [untestable_decision(epoch.t_us, reason, excluded)], before, pending
        # Before the start too: samples of the past must not move a new filter.
        run, pending = split_pending(pending, epoch.t_us)
        if core.motion is None:
            return *self._start(epoch, observation, core), pending
        interval_s = update_interval_s(core.imu.interval_s, run)
        core = core._replace(imu=core.imu._replace(mag_b=mag_b, interval_s=interval_s))
        assert core.motion is not None
        motion, known, ionosphere = core.motion, core.differences, broadcast.ionosphere
        found, known, excluded = compare_ranges(
            epoch, observation, motion, known, core.trust.excluded, ionosphere, self.config
        )
        core = core._replace(trust=core.trust._replace(excluded=excluded), differences=known)
        results, core = self._run_stages(epoch, observation, run, core)
        return [*results, *found], core, pending

    def _continue(self, core: DetectorCore, t_us: int) -> tuple[DetectorCore, str]:
        """The core at an epoch, reset where a gap or a jump of time demands it; or why the epoch
        cannot be used."""
        if core.timing.ranges_us is None:
            core = _reset(core)  # its filter came from the receiver's own position
        elif core.motion is not None:  # it is at the epoch before, testable or not
            timing = _update_spacing(core.timing, t_us - core.motion.t_us)
            core = core._replace(timing=timing)
        if core.motion is None:
            return core, ""
        since_us, reset_us = t_us - core.motion.t_us, self._reset_us(core.timing)
        # A small step back is a late epoch; a large one is a new start of the clock.
        if -reset_us < since_us <= 0:
            return core, f"time went back by {-since_us * 1e-6:.3f} s"
        if since_us <= 0:
            return _reset(core), ""
        gap_us = t_us - _last_update_us(core)
        return (_interrupt(core, gap_us, self.config) if gap_us > reset_us else core), ""

    def _start(
        self, epoch: Epoch, observation: EpochObservation, core: DetectorCore
    ) -> tuple[list[Result], DetectorCore]:
        excluded, ionosphere = core.trust.excluded, core.broadcast.ionosphere
        trusted = np.array([name not in excluded for name in observation.satellites])
        used = observation.select(trusted)
        fix = solve_initial_fix(epoch.t_us, used, self.config, ionosphere)
        if fix.motion is None and not trusted.all():  # better than no position
            excluded, used = {}, observation
            fix = solve_initial_fix(epoch.t_us, used, self.config, ionosphere)
            core = core._replace(trust=core.trust._replace(excluded=excluded))
        if core.timing.before_gap is not None:
            fix = check_against_prior(fix, core.timing.before_gap, self.config)
        if fix.motion is None:
            return [untestable_decision(epoch.t_us, fix.reason, excluded)], core
        excluded = add_exclusions(excluded, fix.faulty, epoch.t_us, epoch.t_us)
        core = core._replace(
            motion=fix.motion,
            trust=core.trust._replace(
                excluded=excluded,
                unexplained_since_us=None,
                to_confirm=CONFIRMING_EPOCHS if fix.dof < LEAST_START_DOF else 0,
            ),
            memory=core.memory._replace(ramps=None),
            timing=core.timing._replace(ranges_us=epoch.t_us, before_gap=None),
            history=(),
        )
        return [build_start_decision(epoch, used, fix, core)], core

    def _run_stages(
        self, epoch: Epoch, observation: EpochObservation, run: ImuRun, core: DetectorCore
    ) -> tuple[list[Result], DetectorCore]:
        config, t_us, history = self.config, epoch.t_us, core.history
        # Records hold no history: they must not hold each other.
        core = core._replace(history=())
        outcome = run_stages(t_us, observation, run, core, history, config)
        # One in, one out: the history stays as long as `history_s`.
        if history and history[0].t_us < t_us - config.history_s * 1e6:
            history = history[1:]
        record = EpochRecord(t_us, core, observation, run)
        record, outcome, wrong = try_other_ephemerides(epoch, record, outcome, history, config)
        history = (*history, record)
        onsets = late_onsets(outcome.tested, record.core, t_us, config)
        if onsets:
            outcome = repair(outcome, onsets, history, config)
            history = outcome.core.history
        # Without a filter there is nothing to repair.
        core = outcome.core._replace(history=history if outcome.core.motion else ())
        tested = outcome.tested
        if tested is None:
            return [untestable_decision(t_us, outcome.reason, core.trust.excluded)], core
        decision = build_decision(epoch, tested, core, bool(onsets), config)
        results: list[Result] = [with_wrong_ephemerides(decision, wrong)]
        results += imu_results(epoch, tested, core.imu, config) + rate_results(epoch, tested)
        if core.motion is not None:
            results += clock_results(core.motion, core.history)
        return results, core


def run_detector(detector: Detector, samples: Iterable[Sample]) -> list[Result]:
    """All results of a detector on samples in order of time."""
    results, _ = detector.step(block_of(samples), detector.new_state())
    return results


def _reset(core: DetectorCore) -> DetectorCore:
    """The core without its filter and the parts that depend on the filter."""
    trust = core.trust._replace(
        excluded={}, carry_off=None, jump_m=None, unbounded=False, misled=False
    )
    memory = core.memory._replace(frozen=NOTHING_FROZEN, ramps=None)
    return core._replace(motion=None, trust=trust, memory=memory, history=())


def _last_update_us(core: DetectorCore) -> int:
    """When the filter last used a measurement: it predicts on while nothing is testable."""
    assert core.motion is not None
    if core.timing.ranges_us is None:
        return core.motion.t_us
    last_fix = core.receiver.last_fix
    return max(core.timing.ranges_us, last_fix.t_us if last_fix is not None else 0)


def _interrupt(core: DetectorCore, gap_us: int, config: DetectorConfig) -> DetectorCore:
    """The core after a gap too long to bridge: its position and its exclusions are still known."""
    known, motion, core = core.trust, core.motion, _reset(core)
    if gap_us <= config.sigma.slow_s * 1e6:  # a satellite's fault lasts about as long
        excluded: Exclusions = {
            name: replace(entry, healthy_since_us=None) for name, entry in known.excluded.items()
        }
        trust = core.trust._replace(
            excluded=excluded, jump_m=known.jump_m, unbounded=known.unbounded, misled=known.misled
        )
        core = core._replace(trust=trust)
    return core._replace(timing=core.timing._replace(before_gap=motion))


def _update_spacing(timing: EpochTiming, gap_us: int) -> EpochTiming:
    """The time between epochs, once two gaps in a row are the same."""
    spacing_us = timing.spacing_us
    # Compared with the known spacing first: the usual case changes nothing.
    if abs(gap_us - spacing_us) <= SPACING_JITTER * spacing_us:
        return timing
    # Two gaps in a row: a single missing epoch is no new spacing.
    if abs(gap_us - timing.gap_us) <= SPACING_JITTER * gap_us:
        spacing_us = min(gap_us, SPACING_MAX_US)
    return timing._replace(spacing_us=spacing_us, gap_us=gap_us)
