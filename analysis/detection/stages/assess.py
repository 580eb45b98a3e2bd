"""Assess: an epoch's innovations against the prediction, and every test statistic of them.

Where a receiver has set its clock the prediction follows; where other satellites are used than at
the last epoch their learned offsets are frozen.
"""

import itertools
import math

import numpy as np

from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.covariance_release import CLOCK_JUMP_M, free_clock
from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.inertial import X_CLOCK
from analysis.detection.filter.information import lasting_covariance, normal_equations
from analysis.detection.filter.measurement import (
    NO_INNOVATIONS,
    EpochObservation,
    Innovations,
    predict_innovations,
)
from analysis.detection.filter.propagation import Prediction
from analysis.detection.isolation.epoch_memory import (
    EpochMemory,
    freeze_offsets,
    frozen_offsets_m,
)
from analysis.detection.isolation.epoch_statistics import (
    EpochStatistics,
    compute_statistics,
    parity_test,
)
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.values import Value

MOVED_PROBABILITY = 0.01  # of a larger shift by lasting errors; without it a start drifted by 108 m


class Assessment(Value, frozen=True):
    """An epoch before any verdict: satellites above the mask with their innovations.

    `satellites` are trusted, with `innovations` and their `statistics`; `excluded` are not, with
    `excluded_innovations`. `prediction` and `memory` are those that the innovations hold for;
    `clock_jumped` says that the receiver set its clock.
    """

    prediction: Prediction
    memory: EpochMemory
    satellites: tuple[str, ...]
    innovations: Innovations
    excluded: tuple[str, ...]
    excluded_innovations: Innovations
    statistics: EpochStatistics
    clock_jumped: bool = False

    @property
    def shortage(self) -> str:
        """Why there are too few satellites to test; empty where there are enough."""
        # Without the IMU one more than the unknowns, three of position and a clock per system; with
        # it the prediction can be contradicted by three.
        inertial = self.prediction.motion.inertial
        needed = 3 if inertial else 4 + max(self.statistics.systems, 1)
        count = len(self.satellites)
        if count >= needed:
            return ""
        return f"{count} healthy satellites above the mask; {needed} are needed"


def assess(
    observation: EpochObservation, prediction: Prediction, core: DetectorCore, config: FilterConfig
) -> Assessment:
    """The epoch against the prediction."""
    memory = core.memory
    assessment = compare(observation, prediction, core, memory, config)
    jump_m = _clock_jump_m(assessment)
    if jump_m:
        x = prediction.motion.x.copy()
        x[X_CLOCK] += jump_m
        motion = free_clock(prediction.motion._replace(x=x))
        prediction = prediction._replace(motion=motion)
        assessment = compare(observation, prediction, core, memory, config)
    # Again at a change of satellites: the innovations must be those with the new offsets.
    if memory.ramps is not None and memory.ramps.names != assessment.satellites:
        memory = freeze_offsets(memory, prediction.motion.t_us, config)
        memory = _limit_frozen(memory, assessment, config)
        assessment = compare(observation, prediction, core, memory, config)
    return assessment._replace(clock_jumped=True) if jump_m else assessment


def compare(
    observation: EpochObservation,
    prediction: Prediction,
    core: DetectorCore,
    memory: EpochMemory,
    config: FilterConfig,
) -> Assessment:
    """The innovations of an observation and their statistics, with the offsets in `memory`."""
    names, excluded, motion = observation.satellites, core.trust.excluded, prediction.motion
    found = predict_innovations(observation, motion.x, config.sigma, core.broadcast.ionosphere)
    offset_m = frozen_offsets_m(memory.frozen, names, motion.t_us, config)
    found = found._replace(range_m=found.range_m - offset_m)
    # Not `<`, so that a satellite of unknown elevation counts as below.
    above = found.elevation_rad >= config.mask_rad
    out: tuple[str, ...] = ()
    found_out = NO_INNOVATIONS
    if excluded or not above.all():
        # Excluded satellites have innovations too: they earn their readmission by these.
        outside = np.array([name in excluded for name in names])
        (out, found_out), (names, found) = (
            (tuple(itertools.compress(names, keep)), found.select(keep))
            for keep in (above & outside, above & ~outside)
        )
    lasting_s = config.sigma.lasting_s
    ranges = found.equations()
    if len(ranges.white):
        # By as much as lasting errors have changed since; other satellites have others.
        others = memory.ramps is not None and memory.ramps.names != names
        changed = 1.0 if others else 2.0 - 2.0 * math.exp(-prediction.dt_s / lasting_s)
        p, observed = motion.p.copy(), np.ix_(ranges.states, ranges.states)
        p[observed] += changed * lasting_covariance(ranges)
        prediction = prediction._replace(motion=motion._replace(p=p))
    statistics = compute_statistics(found, ranges, prediction.motion.p)
    return Assessment(prediction, memory, names, found, out, found_out, statistics)


def _limit_frozen(memory: EpochMemory, assessment: Assessment, config: FilterConfig) -> EpochMemory:
    """The memory with its frozen offsets scaled down where they move position and clock further
    than lasting errors plausibly do: what one change of satellites adds is kept by the next."""
    found, t_us = assessment.innovations, assessment.prediction.motion.t_us
    offset_m = frozen_offsets_m(memory.frozen, assessment.satellites, t_us, config)
    normal = normal_equations(found.geometry, found.variance, offset_m, found.variance)
    moved = normal.total - parity_test(normal)[0]
    limit = config.sigma.slow**2 * chi_square_threshold(len(normal.b), MOVED_PROBABILITY)
    if moved <= limit:
        return memory
    share = math.sqrt(limit / moved)
    offsets_m = {name: share * offset_m for name, offset_m in memory.frozen.offsets_m.items()}
    return memory._replace(frozen=memory.frozen._replace(offsets_m=offsets_m))


def _clock_jump_m(assessment: Assessment) -> float:
    """How far the receiver set its clock; 0 if it did not."""
    used, outside = assessment.innovations, assessment.excluded_innovations
    ranges_m = np.concatenate((used.range_m, outside.range_m))
    far = np.count_nonzero(np.abs(ranges_m) > CLOCK_JUMP_M)
    # Half of them at least: no fault has this on most satellites at once.
    if not 2 * far >= len(ranges_m) > 0:
        return 0.0
    # The median: a single faulty satellite must not set the clock.
    middle_m = sorted(ranges_m.tolist())[len(ranges_m) // 2]
    return middle_m if abs(middle_m) > CLOCK_JUMP_M else 0.0
