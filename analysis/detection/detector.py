"""The detector: samples in, a decision for each GNSS epoch out."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from analysis.detection.decision_record import decision, imu_results, started, untestable
from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import NOTHING_HELD, Core, Record, State
from analysis.detection.epoch_outcome import Outcome
from analysis.detection.filter.initial_fix import start
from analysis.detection.filter.measurement import Observed, choose, observe, why_none
from analysis.detection.filter.propagation import keep_pending, split_pending
from analysis.detection.isolation.epoch_test import judge_epoch
from analysis.detection.isolation.exclusion import exclude
from analysis.detection.isolation.ramp_test import onset_of
from analysis.detection.sensors.receiver_fix import step_position
from analysis.orbits.broadcast import pack_ephemeris
from analysis.results import Result
from analysis.samples.block import EPOCH, FIX, Block, ImuRun, Piece, block_of, pieces
from analysis.samples.sample import (
    EphemerisSample,
    Epoch,
    GpsFix,
    IonosphereSample,
    Sample,
)

EPHEMERIDES_KEPT = 16  # per satellite, the newest


@dataclass(frozen=True)
class Detector:
    """Finds which satellite, or the IMU, is lying; see docs/fdi.md."""

    config: DetectorConfig = field(default_factory=DetectorConfig)

    def new_state(self) -> State:
        """Nothing known."""
        return State(Core(None, {}, np.array(self.config.ionosphere, dtype=float)))

    def step(self, samples: Sample | Block, state: State) -> tuple[list[Result], State]:
        """Decisions that a block of samples, or a single one, allows, and the next state."""
        results: list[Result] = []

        def wanted(t_us: int) -> bool:
            return self.wants_fix(state.core, t_us)

        for piece in pieces(samples, wanted):
            said, state = self.take(piece, state)
            results += said
        return results, state

    def take(self, piece: Piece, state: State) -> tuple[list[Result], State]:
        """The same for samples up to an event."""
        core, pending, mag_b = state
        if len(piece.ids):
            number = core.imu_id
            if number is None:
                number = int(piece.ids[0])
                core = core._replace(imu_id=number)
            pending = keep_pending(piece.of_imu(number), pending)
        if piece.mag >= 0:
            mag_b = piece.block.values[piece.mag, :3].copy()
        state = State(core, pending, mag_b)
        if piece.kind == FIX and self.wants_fix(core, piece.t_us):
            fix = piece.event
            assert isinstance(fix, GpsFix)
            return step_position(fix, state, self.config)
        if piece.kind < EPOCH:
            return [], state
        event = piece.event
        if isinstance(event, Epoch):
            return self._epoch(event, state)
        if isinstance(event, EphemerisSample):
            return [], State(_learn(core, event), pending, mag_b)
        if isinstance(event, IonosphereSample):
            known = np.array(event.alpha + event.beta)
            return [], State(core._replace(ionosphere=known), pending, mag_b)
        return [], state

    def wants_fix(self, core: Core, t_us: int) -> bool:
        """Whether there are no raw ranges, so that a receiver's own position is needed."""
        return core.ranges_us is None or t_us - core.ranges_us >= self.config.reset_s * 1e6

    def _epoch(self, epoch: Epoch, state: State) -> tuple[list[Result], State]:
        core, pending, mag_b = state
        chosen = core.chosen
        if chosen is None or not chosen.serves(epoch):
            chosen = choose(epoch, core.ephemerides, self.config.systems)
            core = core._replace(chosen=chosen)
        observed = observe(epoch, chosen)
        if observed is None:
            return [untestable(epoch.t_us, why_none(epoch, core.ephemerides), core.excluded)], state
        if core.ranges_us is None or epoch.t_us - core.ranges_us > self.config.reset_s * 1e6:
            core = _forgotten(core)  # what there is came from the receiver's own position
        motion = core.motion
        if motion is not None:
            since_s = (epoch.t_us - motion.t_us) * 1e-6
            if -self.config.reset_s < since_s <= 0.0:
                return [
                    untestable(epoch.t_us, f"time went back by {-since_s:.3f} s", core.excluded)
                ], state
            if not 0.0 < since_s <= self.config.reset_s:
                core = _forgotten(core)
                motion = None
        run, pending = split_pending(pending, epoch.t_us)
        if motion is None:
            results, core = self._start(epoch, observed, core)
            return results, State(core, pending, mag_b)
        history = core.history
        core = core._replace(history=(), mag_b=mag_b)
        results, core = self._test(epoch, observed, run, core, history)
        return results, State(core, pending, mag_b)

    def _start(self, epoch: Epoch, observed: Observed, core: Core) -> tuple[list[Result], Core]:
        begun = start(epoch.t_us, observed, self.config, core.ionosphere)
        if begun.motion is None:
            return [untestable(epoch.t_us, begun.reason, core.excluded)], core
        core = core._replace(
            motion=begun.motion,
            ranges_us=epoch.t_us,
            excluded=exclude(core.excluded, begun.left_out, epoch.t_us, epoch.t_us),
            unknown_since_us=None,
            memory=None,
            history=(),
        )
        return [started(epoch, observed, begun, core)], core

    def _test(
        self,
        epoch: Epoch,
        observed: Observed,
        run: ImuRun,
        core: Core,
        history: tuple[Record, ...],
    ) -> tuple[list[Result], Core]:
        config = self.config
        outcome = judge_epoch(epoch.t_us, observed, run, core, config)
        if history and history[0].t_us < epoch.t_us - config.history_s * 1e6:
            history = history[1:]
        history = (*history, Record(epoch.t_us, core, observed, run))
        late = self._late(outcome, core, epoch.t_us)
        if late:
            outcome = self._repaired(outcome, late, history)
            history = outcome.core.history
        core = outcome.core._replace(history=history if outcome.core.motion else ())
        if outcome.reason:
            return [untestable(epoch.t_us, outcome.reason, core.excluded)], core
        said = decision(epoch, outcome, core, bool(late), config)
        return [said, *imu_results(epoch, outcome, config)], core

    def _late(self, outcome: Outcome, core: Core, t_us: int) -> dict[str, int]:
        """Satellites found faulty now, and since when, where that was earlier."""
        slow = outcome.slow
        onsets = {}
        if slow is not None and slow.hypothesis == "satellites":
            onsets[slow.satellite] = slow.onset_us
        for i in outcome.left_out:
            onset_us = onset_of(core.memory, outcome.names[i], t_us, self.config)
            if onset_us < t_us:
                onsets[outcome.names[i]] = onset_us
        return onsets

    def _repaired(
        self, outcome: Outcome, late: dict[str, int], history: tuple[Record, ...]
    ) -> Outcome:
        """The contaminated stretch once more, without the satellites in `late`.

        The verdict stays the one of `outcome`; the filter, its memory and its history are new.
        """
        since_us = min(late.values())
        kept = tuple(record for record in history if record.t_us <= since_us)
        again = history[len(kept) :]
        core = again[0].core
        found_us = history[-1].t_us
        excluded = core.excluded
        for name, onset_us in late.items():
            excluded = exclude(excluded, (name,), onset_us, found_us)
        core = core._replace(excluded=excluded)
        replayed = list(kept)
        for record in again:
            if core.motion is None:
                break
            replayed.append(Record(record.t_us, core, record.observed, record.run))
            core = judge_epoch(record.t_us, record.observed, record.run, core, self.config).core
        excluded = {**outcome.core.excluded, **core.excluded}
        core = core._replace(excluded=excluded, history=tuple(replayed), chosen=outcome.core.chosen)
        return outcome._replace(core=core)


def run(detector: Detector, samples: Iterable[Sample]) -> list[Result]:
    """All results of a detector over samples in order of time."""
    results, _ = detector.step(block_of(samples), detector.new_state())
    return results


def _forgotten(core: Core) -> Core:
    """The core without its filter."""
    return core._replace(motion=None, excluded={}, held=NOTHING_HELD, memory=None, history=())


def _learn(core: Core, sample: EphemerisSample) -> Core:
    """The core with one ephemeris more; the same one again changes nothing."""
    ephemeris = sample.ephemeris
    stored = core.ephemerides.get(ephemeris.satellite, ())
    if any(known == ephemeris for known, _ in stored):
        return core
    kept = (*stored[-EPHEMERIDES_KEPT + 1 :], (ephemeris, pack_ephemeris(ephemeris)))
    return core._replace(ephemerides={**core.ephemerides, ephemeris.satellite: kept}, chosen=None)
