"""A wrong ephemeris as a hypothesis: where another one fits, the satellite is healthy.

An isolated satellite whose ephemerides contradict each other is tested once more with the next best
of them. If its range fits then, the ephemeris is not used again, and the satellite is not excluded.
Where precise orbits are known, every broadcast ephemeris is compared with these.
"""

from collections.abc import Iterable

import numpy as np
from msgspec.structs import replace

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore, EpochRecord
from analysis.detection.filter.ephemerides import EphemerisSelection
from analysis.detection.filter.measurement import EpochObservation, observe, predict_innovations
from analysis.detection.stages.epoch_outcome import EpochOutcome
from analysis.detection.stages.epoch_stages import run_stages
from analysis.results import Decision
from analysis.samples.sample import Epoch, Orbit

CONTRADICTING_SIGMAS = 3.0  # of a range: two ephemerides that differ by less explain no fault
EXPLAINED = ("none", "satellites")


def try_other_ephemerides(
    epoch: Epoch,
    record: EpochRecord,
    outcome: EpochOutcome,
    history: tuple[EpochRecord, ...],
    config: DetectorConfig,
) -> tuple[EpochRecord, EpochOutcome, tuple[str, ...]]:
    """The epoch's record and outcome with other ephemerides, where these clear an isolated
    satellite, and what was wrong; both unchanged and nothing where they do not."""
    known, faulty = record.core.broadcast, _isolated(outcome)
    if not faulty or known.selection is None:
        return record, outcome, ()
    used = zip(known.selection.names, known.selection.used, strict=True)
    wrong = {name: ephemeris for name, ephemeris in used if name in faulty}
    broadcast = known._replace(wrong=known.wrong.union(wrong.values()), selection=None)
    places = [i for i, name in enumerate(epoch.satellites) if name in faulty]
    observation, _ = observe(epoch.select(places), broadcast, config)
    if observation is None:
        return record, outcome, ()
    own = record.observation.select(np.isin(record.observation.satellites, observation.satellites))
    ours, theirs = (_ranges_m(o, record.core, config) for o in (own, observation))
    doubtful = {
        name
        for name in faulty & theirs.keys()
        if abs(ours[name][0] - theirs[name][0]) > CONTRADICTING_SIGMAS * ours[name][1]
    }
    if not doubtful:
        return record, outcome, ()
    observation, broadcast = observe(epoch, broadcast, config)
    assert observation is not None
    again = record._replace(core=record.core._replace(broadcast=broadcast), observation=observation)
    other = run_stages(epoch.t_us, observation, record.run, again.core, history, config)
    cleared = sorted(doubtful - _isolated(other))
    explained = other.tested is not None and other.tested.verdict.ranges.hypothesis in EXPLAINED
    if not cleared or not explained:
        return record, outcome, ()
    return again, other, tuple(f"{_named(wrong[name])} is wrong: another fits" for name in cleared)


def _named(ephemeris: Orbit) -> str:
    toe = round(ephemeris.toe_s / 60.0)
    return f"ephemeris of {ephemeris.satellite} of {toe // 60 % 24:02d}:{toe % 60:02d}"


def with_orbits_compared(decision: Decision, selection: EphemerisSelection) -> Decision:
    """The decision with what a new selection found of broadcast ephemerides by precise orbits."""
    off_m = selection.differences_m
    texts = (
        f"{_named(e)} is wrong: {abs(off_m[e.satellite]):.0f} m from its precise orbit and clock"
        for e in sorted(selection.contradicted, key=lambda e: e.satellite)
    )
    return with_wrong_ephemerides(replace(decision, orbit_difference_m=off_m), texts)


def with_wrong_ephemerides(decision: Decision, texts: Iterable[str]) -> Decision:
    """The decision with what is wrong with ephemerides: beside what it isolates already."""
    if not (found := tuple(texts)):
        return decision
    hypothesis = "ephemeris" if decision.hypothesis == "none" else decision.hypothesis
    reason = "; ".join((*([decision.reason] if decision.reason else []), *found))
    found = *(decision.wrong_ephemerides or ()), *found
    return replace(
        decision, alarm=True, hypothesis=hypothesis, reason=reason, wrong_ephemerides=found
    )


def _isolated(outcome: EpochOutcome) -> set[str]:
    """The satellites that the ranges of the epoch isolate."""
    if outcome.tested is None:
        return set()
    names = outcome.tested.assessment.satellites
    return {names[i] for i in outcome.tested.verdict.ranges.faulty}


def _ranges_m(
    observation: EpochObservation, core: DetectorCore, config: DetectorConfig
) -> dict[str, tuple[float, float]]:
    """Each satellite's innovation and its sigma at the filter's newest state."""
    assert core.motion is not None
    ionosphere = core.broadcast.ionosphere
    found = predict_innovations(observation, core.motion.x, config.sigma, ionosphere)
    columns = found.range_m.tolist(), np.sqrt(found.variance).tolist()
    return dict(zip(observation.satellites, zip(*columns, strict=True), strict=True))
