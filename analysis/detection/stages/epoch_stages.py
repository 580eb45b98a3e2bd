"""The stages of an epoch in their order, and a replay of past epochs."""

from collections.abc import Mapping, Sequence

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore, EpochRecord
from analysis.detection.filter.measurement import EpochObservation
from analysis.detection.filter.propagation import predict
from analysis.detection.isolation.exclusion import Exclusion
from analysis.detection.isolation.ramp_test import ramp_onset_us
from analysis.detection.stages.assess import assess
from analysis.detection.stages.commit import commit, commit_untested
from analysis.detection.stages.epoch_outcome import EpochOutcome, TestedEpoch
from analysis.detection.stages.followed_system import follow_one_system
from analysis.detection.stages.isolate import isolate
from analysis.samples.block import ImuRun


def run_stages(
    t_us: int,
    observation: EpochObservation,
    run: ImuRun,
    core: DetectorCore,
    history: Sequence[EpochRecord],
    config: DetectorConfig,
) -> EpochOutcome:
    """The core after an observed epoch and what the epoch showed.

    `run` are the IMU's samples since the last epoch, `history` the epochs before.
    """
    assert core.motion is not None
    prediction = predict(core.motion, run, t_us, config)
    assessment = assess(observation, prediction, core, config)
    if assessment.shortage:
        return commit_untested(assessment, core, config)
    verdict = isolate(assessment, core, run, history, config)
    verdict = follow_one_system(assessment, verdict, history)
    return commit(assessment, verdict, core, config)


def late_onsets(
    tested: TestedEpoch | None, core: DetectorCore, t_us: int, config: DetectorConfig
) -> dict[str, int]:
    """Satellites isolated now that have been faulty since an earlier epoch, and since when; `core`
    is the one before the epoch."""
    onsets: dict[str, int] = {}
    if tested is None:
        return onsets
    verdict, names = tested.verdict, tested.assessment.satellites
    ramps = verdict.ramps
    if ramps is not None and ramps.hypothesis == "satellites":
        onsets[ramps.satellite] = ramps.onset_us
    for i in verdict.ranges.faulty:
        onset_us = ramp_onset_us(core.memory.ramps, names[i], t_us, config)
        if onset_us < t_us:
            onsets[names[i]] = onset_us
    if onsets and verdict.ranges.whole_system:  # a system fails at once
        return dict.fromkeys((names[i] for i in verdict.ranges.faulty), min(onsets.values()))
    return onsets


def repair(
    outcome: EpochOutcome,
    onsets: Mapping[str, int],
    history: tuple[EpochRecord, ...],
    config: DetectorConfig,
) -> EpochOutcome:
    """The outcome with the contaminated epochs replayed without the satellites in `onsets`.

    The verdict stays that of `outcome`; the filter, its ramp tests and its history are new.
    """
    # From the earliest onset on, every epoch is contaminated.
    since_us = min(onsets.values())
    kept = tuple(record for record in history if record.t_us <= since_us)
    again = history[len(kept) :]
    core, found_us = again[0].core, history[-1].t_us
    excluded, trust = core.trust.excluded, outcome.core.trust
    for name, onset_us in onsets.items():
        # Found now, even if it was excluded then: the replay must not readmit it.
        known = excluded.get(name)
        since = onset_us if known is None else min(onset_us, known.onset_us)
        new = trust.excluded.get(name)
        whole = new is not None and new.whole_system
        excluded = {**excluded, name: Exclusion(since, found_us, whole_system=whole)}
    contradicting = trust.contradicting
    core = core._replace(trust=core.trust._replace(excluded=excluded, contradicting=contradicting))
    replayed, last = list(kept), outcome
    for record in again:
        # The replay may lose the filter where the original did not: the history ends there.
        if core.motion is None:
            break
        last = run_stages(record.t_us, record.observation, record.run, core, replayed, config)
        replayed.append(EpochRecord(record.t_us, core, record.observation, record.run))
        core = last.core
    # What the replay excluded takes precedence over what was excluded before.
    excluded = {**trust.excluded, **core.trust.excluded}
    core = core._replace(
        trust=core.trust._replace(excluded=excluded),
        history=tuple(replayed),
        broadcast=outcome.core.broadcast,
    )
    tested = outcome.tested
    if tested is not None:
        tested = tested._replace(bounds=last.tested.bounds if last.tested else None)
    return EpochOutcome(core, tested, outcome.reason)
