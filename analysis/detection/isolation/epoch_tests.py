"""The main test F00 on all trusted pseudoranges, that of the Doppler rates, and their verdicts.

A wrong attitude or force shows in the rates seconds before it shows in the ranges.
"""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.covariance_release import (
    free_by_rates,
    free_clock,
    free_position,
    free_system_clocks,
)
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import CLOCK
from analysis.detection.filter.information import (
    NO_RATES,
    NormalEquations,
    innovation_statistic,
    inverse_covariance,
    rate_equations,
)
from analysis.detection.filter.measurement import NO_INNOVATIONS, Innovations
from analysis.detection.isolation.epoch_statistics import LEAST_RATES, EpochStatistics
from analysis.detection.isolation.hypotheses import (
    SYSTEM_CLOCK,
    IsolationVerdict,
    group_by_system,
    select_hypothesis,
)
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.values import Value
from analysis.samples.sample import Vector

MOST_ROUNDS = 3  # a clock jump, a wrong prediction and what is left: each is one round


class RangeVerdict(Value, frozen=True):
    """Result of the range test, and which ranges the filter may use.

    `motion` is the prediction; where a part of it was found wrong, that part's covariance is
    released (`prediction_freed`). `usable` are the innovations of the satellites that may be used,
    none where no explanation was found. `faulty` are the indices of the isolated satellites; the
    statistic is that of the first round. `whole_system`: an entire system is faulty.
    """

    motion: MotionEstimate
    hypothesis: str
    alarm: bool
    faulty: tuple[int, ...]
    statistic: float
    threshold: float
    probabilities: dict[str, float]
    usable: Innovations
    prediction_freed: bool
    whole_system: bool = False


def largest_subset(count: int, wanted: int) -> int:
    """How many of `count` satellites may be left out: enough must stay to make the set unique."""
    # One satellite may be left out of four even so: the filter's prediction supports the others.
    return max(min(wanted, (count - 4) // 2), 1 if count >= 4 else 0)


def run_range_test(
    motion: MotionEstimate,
    innovations: Innovations,
    statistics: EpochStatistics,
    by_rates: str,
    offset_m: Vector,
    config: DetectorConfig,
) -> RangeVerdict:
    """Test n ranges against the prediction, after the rates' verdict `by_rates` on it.

    `offset_m` (n,) are the satellites' learned offsets.
    """
    freed, q = free_by_rates(motion, by_rates), statistics.q
    if freed is not motion:
        # The statistic is computed again only where the covariance changed.
        q = innovation_statistic(freed.p, statistics.ranges)
    threshold = chi_square_threshold(len(innovations.range_m), config.p_false_alarm)
    if q <= threshold:
        return RangeVerdict(freed, "none", False, (), q, threshold, {}, innovations, False)
    return isolate_ranges(freed, innovations, q, threshold, offset_m, config)


def isolate_ranges(
    motion: MotionEstimate,
    innovations: Innovations,
    q: float,
    threshold: float,
    offset_m: Vector,
    config: DetectorConfig,
    by_past: bool = False,
) -> RangeVerdict:
    """The verdict on n ranges whose statistic q failed F00.

    `offset_m` (n,) are the satellites' learned offsets: where some satellites are excluded they are
    subtracted from the rest, so that the position does not jump with the geometry. `by_past` asks
    for a verdict although F00 passed, because a test with memory failed.
    """
    hypothesis, verdict, motion = _explain(motion, innovations, threshold, by_past, config)
    usable = innovations
    if verdict.hypothesis == "satellites":
        # Offsets learned while a whole system moved are its shift, not offsets of the others.
        offset_m = offset_m * (not verdict.whole_system)
        usable = innovations._replace(range_m=innovations.range_m - offset_m)
        usable = usable.without(verdict.subset)
    elif verdict.hypothesis != "none":
        usable = NO_INNOVATIONS
    reported = hypothesis
    # An IMU found wrong in an earlier round outweighs what is found in a later one.
    if verdict.hypothesis != "none" and hypothesis in ("none", "clock", SYSTEM_CLOCK):
        reported = verdict.hypothesis
    # Receivers set their clocks: that is reported, and is no alarm.
    alarm = reported not in ("none", "clock")
    reported = "clock" if reported == SYSTEM_CLOCK else reported
    subset, chances, whole = verdict.subset, verdict.probabilities, verdict.whole_system
    return RangeVerdict(motion, reported, alarm, subset, q, threshold, chances, usable, True, whole)


def _explain(
    motion: MotionEstimate,
    innovations: Innovations,
    threshold: float,
    by_past: bool,
    config: DetectorConfig,
) -> tuple[str, IsolationVerdict, MotionEstimate]:
    """Explain a failed test; release the clock or the position where they explain it, and test
    again.

    Returns the hypothesis so far, the last verdict ("none" once the rest passes), and the filter. A
    prediction without an IMU claims little: its failure is a manoeuvre, not a fault.
    """
    hypothesis = "none"
    probabilities: dict[str, float] = {}
    largest = largest_subset(len(innovations.range_m), config.left_out)
    h, v = innovations.geometry, innovations.range_m
    position, clock, systems, whole = h[:, :3], h[:, CLOCK : CLOCK + 1], group_by_system(h), False
    normal = innovations.equations()
    for number in range(MOST_ROUNDS):
        forced = by_past and number == 0
        if not forced and innovation_statistic(motion.p, normal) <= threshold:
            return hypothesis, IsolationVerdict("none", (), probabilities, whole), motion
        m = inverse_covariance(motion.p, normal)
        p = config.p_false_alarm
        verdict = select_hypothesis(m, v, position, clock, p, largest, config.rule, systems)
        whole = whole or verdict.whole_system
        # The probabilities of the first round: those before anything was released.
        probabilities = probabilities or verdict.probabilities
        if verdict.hypothesis == "clock":
            motion = free_clock(motion)
            hypothesis = "clock" if hypothesis == "none" else hypothesis
        elif verdict.hypothesis == SYSTEM_CLOCK:
            motion = free_system_clocks(motion)
            hypothesis = SYSTEM_CLOCK if hypothesis in ("none", "clock") else hypothesis
        elif verdict.hypothesis == "imu":
            hypothesis = "imu" if motion.inertial else hypothesis
            motion = free_position(motion)
        else:
            verdict = verdict._replace(probabilities=probabilities, whole_system=whole)
            return hypothesis, verdict, motion
    # No explanation within three rounds.
    return hypothesis, IsolationVerdict("multiple-unknown", (), probabilities, whole), motion


class RateVerdict(Value, frozen=True):
    """The result of the rate test: the hypothesis, the rates that may be used, and the indices of
    the satellites whose rates are wrong."""

    statistic: float | None
    threshold: float | None
    dof: int
    hypothesis: str
    usable: NormalEquations
    faulty: tuple[int, ...] = ()


def run_rate_test(
    motion: MotionEstimate,
    innovations: Innovations,
    statistics: EpochStatistics,
    config: DetectorConfig,
) -> RateVerdict:
    """Test the Doppler rates of n satellites against the predicted velocity."""
    count = statistics.rate_count
    if not config.doppler or count < LEAST_RATES:
        return RateVerdict(None, None, 0, "none", NO_RATES)
    usable = statistics.rates
    threshold = chi_square_threshold(count, config.p_other)
    if statistics.q_rate <= threshold:
        return RateVerdict(statistics.q_rate, threshold, count, "none", usable)
    known = np.flatnonzero(np.isfinite(innovations.rate_mps))
    m, velocity, drift = inverse_covariance(motion.p, usable), usable.a[:, :3], usable.a[:, 3:]
    largest, p = largest_subset(count, config.left_out), config.p_other
    systems = group_by_system(innovations.geometry[known])
    verdict = select_hypothesis(m, usable.v, velocity, drift, p, largest, config.rule, systems)
    faulty: tuple[int, ...] = ()
    if verdict.hypothesis == "satellites":
        faulty = tuple(known[list(verdict.subset)].tolist())
        rate_mps = innovations.rate_mps.copy()
        rate_mps[list(faulty)] = np.nan
        usable = rate_equations(innovations.geometry, innovations.rate_variance, rate_mps)
    # No explanation: no rate is used, the ranges decide alone.
    elif verdict.hypothesis in ("multiple-unknown", SYSTEM_CLOCK):
        usable = NO_RATES
    return RateVerdict(statistics.q_rate, threshold, count, verdict.hypothesis, usable, faulty)
