"""The detector: samples in, a decision for each GNSS epoch out."""

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.detection.decision_record import (
    build_decision,
    build_start_decision,
    imu_results,
    rate_results,
    untestable_decision,
)
from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import (
    NOTHING_FROZEN,
    DetectorCore,
    DetectorState,
    EpochRecord,
)
from analysis.detection.epoch_outcome import EpochOutcome
from analysis.detection.filter.filter_state import Exclusion
from analysis.detection.filter.initial_fix import check_against_prior, solve_initial_fix
from analysis.detection.filter.measurement import (
    EpochObservation,
    observe_epoch,
    select_ephemerides,
    unusable_reason,
)
from analysis.detection.filter.propagation import add_pending, split_pending, update_interval_s
from analysis.detection.isolation.epoch_test import judge_epoch
from analysis.detection.isolation.exclusion import add_exclusions
from analysis.detection.isolation.ramp_test import ramp_onset_us
from analysis.detection.receiver.clock_drift import clock_results
from analysis.detection.receiver.receiver_fix import step_position
from analysis.orbits.broadcast import pack_ephemeris
from analysis.results import Result
from analysis.samples.block import EPOCH, FIX, Block, BlockSlice, ImuRun, block_of, split_at_events
from analysis.samples.sample import (
    EphemerisSample,
    Epoch,
    GpsFix,
    IonosphereSample,
    Sample,
    StateVector,
)
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

BRIDGED_SPACINGS = 2.5  # epochs that may be missing at the rate they come, whatever `reset_s`
SPACING_JITTER = 0.2  # of a gap: less is jitter
SPACING_MAX_US = 120_000_000  # the filter knows nothing of the motion after longer
# Broadcast coefficients leave a fifth of the delay, typical ones about half of it.
TYPICAL_IONOSPHERE_FACTOR = 2.5
MOST_EPHEMERIDES = 512  # per satellite: three days of Galileo's


@dataclass(frozen=True)
class Detector:
    """Finds which satellite, or the IMU, is lying; see docs/fdi.md."""

    config: DetectorConfig = field(default_factory=DetectorConfig)

    def new_state(self) -> DetectorState:
        """Nothing known."""
        typical = self.config.ionosphere == DetectorConfig().ionosphere
        doubt = TYPICAL_IONOSPHERE_FACTOR if typical else 1.0
        return DetectorState(
            DetectorCore(None, {}, np.array([*self.config.ionosphere, doubt], dtype=float))
        )

    def step(
        self, samples: Sample | Block, state: DetectorState
    ) -> tuple[list[Result], DetectorState]:
        """Decisions that a block of samples, or a single one, allows, and the next state."""
        results: list[Result] = []

        # Asked for each fix: whether it is needed may change within a block.
        def wanted(t_us: int) -> bool:
            return self.wants_fix(state.core, t_us)

        for piece in split_at_events(samples, wanted):
            found, state = self.step_piece(piece, state)
            results += found
        return results, state

    def step_piece(
        self, piece: BlockSlice, state: DetectorState
    ) -> tuple[list[Result], DetectorState]:
        """The same for samples up to an event."""
        core, pending, mag_b = state
        if len(piece.ids):
            number = core.imu_id
            if number is None:
                # The first IMU that speaks stays the one that is used.
                number = int(piece.ids[0])
                core = core._replace(imu_id=number)
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
        event = piece.event
        if isinstance(event, Epoch):
            return self._epoch(event, state)
        if isinstance(event, EphemerisSample):
            return [], DetectorState(_learn(core, event), pending, mag_b)
        if isinstance(event, IonosphereSample):
            known = np.array((*event.alpha, *event.beta, 1.0))
            return [], DetectorState(core._replace(ionosphere=known), pending, mag_b)
        return [], state

    def wants_fix(self, core: DetectorCore, t_us: int) -> bool:
        """Whether there are no raw ranges, so that a receiver's own position is needed."""
        return core.ranges_us is None or t_us - core.ranges_us >= self._reset_us(core)

    def _reset_us(self, core: DetectorCore) -> float:
        """The longest gap of epochs that the filter bridges; some epochs come every 30 s."""
        return max(self.config.reset_s * 1e6, BRIDGED_SPACINGS * core.spacing_us)

    def _epoch(self, epoch: Epoch, state: DetectorState) -> tuple[list[Result], DetectorState]:
        core, pending, mag_b = state
        chosen = core.chosen
        # The choice of ephemerides holds for a while; it is made anew when the sky changes.
        if chosen is None or not chosen.is_valid_for(epoch):
            chosen = select_ephemerides(epoch, core.ephemerides, self.config.systems, chosen)
            core = core._replace(chosen=chosen)
        observed = observe_epoch(epoch, chosen)
        if observed is None:
            return [
                untestable_decision(
                    epoch.t_us, unusable_reason(epoch, core.ephemerides), core.excluded
                )
            ], state
        if core.ranges_us is None:
            core = _forgotten(core)  # what there is came from the receiver's own position
        elif core.motion is not None:  # it is at the epoch before, testable or not
            core = _spaced(core, epoch.t_us - core.motion.t_us)
        reset_us = self._reset_us(core)
        motion = core.motion
        if motion is not None:
            since_us = epoch.t_us - motion.t_us
            # A small step back is a late epoch; a large one is a new start of the clock.
            if -reset_us < since_us <= 0:
                reason = f"time went back by {-since_us * 1e-6:.3f} s"
                return [untestable_decision(epoch.t_us, reason, core.excluded)], state
            alone_us = epoch.t_us - _fed_us(core)
            # Gone back further: nothing known of before holds.
            if since_us <= 0:
                core = _forgotten(core)
            elif alone_us > reset_us:
                core = _interrupted(core, alone_us, self.config)
            motion = core.motion
        # Before the start too: samples of the past must not move a new filter.
        run, pending = split_pending(pending, epoch.t_us)
        if motion is None:
            results, core = self._start(epoch, observed, core)
            return results, DetectorState(core, pending, mag_b)
        history = core.history
        # Taken out while the epoch is judged: records must not hold each other.
        interval_s = update_interval_s(core.imu_interval_s, run)
        core = core._replace(history=(), mag_b=mag_b, imu_interval_s=interval_s)
        results, core = self._test(epoch, observed, run, core, history)
        return results, DetectorState(core, pending, mag_b)

    def _start(
        self, epoch: Epoch, observed: EpochObservation, core: DetectorCore
    ) -> tuple[list[Result], DetectorCore]:
        trusted = np.array([name not in core.excluded for name in observed.satellites])
        used = observed.select(trusted)
        begun = solve_initial_fix(epoch.t_us, used, self.config, core.ionosphere)
        if begun.motion is None and not trusted.all():  # better than no position
            core, used = core._replace(excluded={}), observed
            begun = solve_initial_fix(epoch.t_us, used, self.config, core.ionosphere)
        if core.before is not None:
            begun = check_against_prior(begun, core.before, self.config)
        if begun.motion is None:
            return [untestable_decision(epoch.t_us, begun.reason, core.excluded)], core
        core = core._replace(
            before=None,
            motion=begun.motion,
            ranges_us=epoch.t_us,
            excluded=add_exclusions(core.excluded, begun.faulty, epoch.t_us, epoch.t_us),
            unknown_since_us=None,
            ramps=None,
            history=(),
        )
        return [build_start_decision(epoch, used, begun, core)], core

    def _test(
        self,
        epoch: Epoch,
        observed: EpochObservation,
        run: ImuRun,
        core: DetectorCore,
        history: tuple[EpochRecord, ...],
    ) -> tuple[list[Result], DetectorCore]:
        config = self.config
        outcome = judge_epoch(epoch.t_us, observed, run, core, config, history)
        # One in, one out: the history stays as long as `history_s`.
        if history and history[0].t_us < epoch.t_us - config.history_s * 1e6:
            history = history[1:]
        history = (*history, EpochRecord(epoch.t_us, core, observed, run))
        late = self._late(outcome, core, epoch.t_us)
        if late:
            outcome = self._repaired(outcome, late, history)
            history = outcome.core.history
        # Without a filter there is nothing to repair.
        core = outcome.core._replace(history=history if outcome.core.motion else ())
        if outcome.reason:
            return [untestable_decision(epoch.t_us, outcome.reason, core.excluded)], core
        decided = build_decision(epoch, outcome, core, bool(late), config)
        beside = imu_results(epoch, outcome, config) + rate_results(epoch, outcome)
        if core.motion is not None:
            beside += clock_results(core.motion, core.history)
        return [decided, *beside], core

    def _late(self, outcome: EpochOutcome, core: DetectorCore, t_us: int) -> dict[str, int]:
        """Satellites found faulty now, and since when, where that was earlier."""
        slow = outcome.slow
        onsets = {}
        if slow is not None and slow.hypothesis == "satellites":
            onsets[slow.satellite] = slow.onset_us
        for i in outcome.faulty:
            onset_us = ramp_onset_us(core.ramps, outcome.names[i], t_us, self.config)
            if onset_us < t_us:
                onsets[outcome.names[i]] = onset_us
        return onsets

    def _repaired(
        self, outcome: EpochOutcome, late: dict[str, int], history: tuple[EpochRecord, ...]
    ) -> EpochOutcome:
        """The contaminated stretch once more, without the satellites in `late`.

        The verdict stays the one of `outcome`; the filter, its ramp tests and its history are new.
        """
        # From the earliest onset on, every epoch is contaminated.
        since_us = min(late.values())
        kept = tuple(record for record in history if record.t_us <= since_us)
        again = history[len(kept) :]
        core = again[0].core
        found_us = history[-1].t_us
        excluded = core.excluded
        for name, onset_us in late.items():
            # found now, even if it was excluded then: the replay must not readmit it
            known = excluded.get(name)
            since = onset_us if known is None else min(onset_us, known.onset_us)
            excluded = {**excluded, name: Exclusion(since, found_us)}
        core = core._replace(excluded=excluded)
        replayed, bounds = list(kept), outcome.bounds
        for record in again:
            # The replay may lose the filter where the original did not: what is kept ends there.
            if core.motion is None:
                break
            t_us, observed, run = record.t_us, record.observed, record.run
            again_found = judge_epoch(t_us, observed, run, core, self.config, replayed)
            replayed.append(EpochRecord(t_us, core, observed, run))
            core, bounds = again_found.core, again_found.bounds
        # What the replay found wins over what was known.
        excluded = {**outcome.core.excluded, **core.excluded}
        core = core._replace(excluded=excluded, history=tuple(replayed), chosen=outcome.core.chosen)
        return outcome._replace(core=core, bounds=bounds)


def run_detector(detector: Detector, samples: Iterable[Sample]) -> list[Result]:
    """All results of a detector over samples in order of time."""
    results, _ = detector.step(block_of(samples), detector.new_state())
    return results


def _forgotten(core: DetectorCore) -> DetectorCore:
    """The core without its filter."""
    return core._replace(
        motion=None,
        excluded={},
        frozen=NOTHING_FROZEN,
        ramps=None,
        history=(),
        leapt_m=None,
        carried=None,
        unbounded=False,
        led=False,
    )


def _fed_us(core: DetectorCore) -> int:
    """When the filter last was given anything: it goes on predicting while nothing is testable."""
    assert core.motion is not None
    if core.ranges_us is None:
        return core.motion.t_us
    return max(core.ranges_us, core.last_fix[0] if core.last_fix is not None else 0)


def _interrupted(core: DetectorCore, gap_us: int, config: DetectorConfig) -> DetectorCore:
    """The core after a gap too long to bridge: its place and its exclusions are still known."""
    excluded, leapt_m, unbounded, led = {}, None, False, False
    if gap_us <= config.sigma.slow_s * 1e6:  # what is wrong with a satellite lasts about so long
        leapt_m, unbounded, led = core.leapt_m, core.unbounded, core.led
        excluded = {
            name: replace(entry, healthy_since_us=None) for name, entry in core.excluded.items()
        }
    known = _forgotten(core)._replace(leapt_m=leapt_m, unbounded=unbounded, led=led)
    return known._replace(excluded=excluded, before=core.motion)


def _spaced(core: DetectorCore, gap_us: int) -> DetectorCore:
    """The core with the time between epochs, once two gaps running are the same."""
    spacing_us = core.spacing_us
    # Compared with the known spacing first: the usual case changes nothing.
    if abs(gap_us - spacing_us) <= SPACING_JITTER * spacing_us:
        return core
    # Two gaps running: a single missing epoch is no new spacing.
    if abs(gap_us - core.gap_us) <= SPACING_JITTER * gap_us:
        spacing_us = min(gap_us, SPACING_MAX_US)
    return core._replace(spacing_us=spacing_us, gap_us=gap_us)


def _learn(core: DetectorCore, sample: EphemerisSample) -> DetectorCore:
    """The core with one ephemeris more, in the order of their times.

    One of the same time replaces the one that was known; the same one again changes nothing.
    """
    ephemeris = sample.ephemeris
    stored = core.ephemerides.get(ephemeris.satellite, ())
    at = bisect_left(stored, _time_of(ephemeris), key=lambda known: _time_of(known[0]))
    same_time = at < len(stored) and _time_of(stored[at][0]) == _time_of(ephemeris)
    if same_time and stored[at][0] == ephemeris:
        return core
    packed = pack_ephemeris(ephemeris)
    # The oldest go first.
    kept = (*stored[:at], (ephemeris, packed), *stored[at + same_time :])[-MOST_EPHEMERIDES:]
    # A new ephemeris voids the choice.
    return core._replace(ephemerides={**core.ephemerides, ephemeris.satellite: kept}, chosen=None)


def _time_of(ephemeris: Ephemeris | StateVector) -> tuple[int, float]:
    return ephemeris.week, ephemeris.toe_s
