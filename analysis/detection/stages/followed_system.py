"""Two systems contradict each other, and no test shows which is wrong: one of them is followed.

It is the one whose satellites alone put the receiver nearer to where it would be, had it moved on
as in the seconds before. The position's sigma and levels cover the other system's position too.
"""

from collections.abc import Sequence

import numpy as np

from analysis.detection.detector_state import EpochRecord
from analysis.detection.filter.covariance_release import free_clock, free_position
from analysis.detection.filter.information import NO_RATES
from analysis.detection.filter.measurement import systems_in_use
from analysis.detection.isolation.all_satellites import position_shift
from analysis.detection.isolation.hypotheses import LEAST_MOVED
from analysis.detection.stages.assess import Assessment
from analysis.detection.stages.epoch_outcome import EpochVerdict
from analysis.samples.sample import Vector

LEAST_STEADY_US = 5_000_000  # in each half of the history: its velocity is then known to 1 m/s


def follow_one_system(
    assessment: Assessment, verdict: EpochVerdict, history: Sequence[EpochRecord]
) -> EpochVerdict:
    """The verdict with the satellites of the likelier system usable and all others faulty; as it
    is where it is not about systems, or too little is known."""
    ranges, motion = verdict.ranges, assessment.prediction.motion
    if not (ranges.whole_system and ranges.hypothesis == "multiple-unknown"):
        return verdict
    expected_m, innovations = _expected_position(history, motion.t_us), assessment.innovations
    if expected_m is None:
        return verdict
    off_m: dict[tuple[int, ...], float] = {}
    for column in systems_in_use(innovations.geometry).T:
        own = innovations.select(column > 0.0)
        if len(own.range_m) >= LEAST_MOVED:
            shift_m, _ = position_shift(own)
            others = tuple(np.flatnonzero(column == 0.0).tolist())
            off_m[others] = float(np.linalg.norm(motion.x[:3] + shift_m - expected_m))
    if not off_m:
        return verdict
    others = min(off_m, key=lambda rows: off_m[rows])
    ranges = ranges._replace(
        motion=free_position(free_clock(motion)),
        faulty=others,
        usable=innovations.without(others),
        prediction_freed=True,
    )
    # Their rates may be as wrong as the ranges.
    rates = verdict.rates._replace(usable=NO_RATES)
    return verdict._replace(ranges=ranges, rates=rates, update=None)


def _expected_position(history: Sequence[EpochRecord], t_us: int) -> Vector | None:
    """Where the receiver (3,) would be if it had moved on as in the first half of the history; None
    where that is too short."""
    records = [record.core.motion for record in history if record.core.motion is not None]
    if not records:
        return None
    first, middle = records[0], records[len(records) // 2]
    if min(middle.t_us - first.t_us, t_us - middle.t_us) < LEAST_STEADY_US:
        return None
    share = (t_us - middle.t_us) / (middle.t_us - first.t_us)
    return np.asarray(middle.x[:3] + share * (middle.x[:3] - first.x[:3]))
