"""The main test F00 on all trusted pseudoranges, and the bank when it trips."""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import CLOCK, DRIFT, ERROR_SIZE, ISB, PSI
from analysis.detection.filter.information import innovation_statistic, inverse_covariance
from analysis.detection.filter.measurement import NO_INNOVATIONS, Innovations
from analysis.detection.isolation.constellations import SYSTEM_CLOCK, group_by_system
from analysis.detection.isolation.hypotheses import IsolationVerdict, select_hypothesis
from analysis.detection.values import Value
from analysis.samples.sample import Vector

# What a prediction that was found wrong is trusted to from then on.
FREE_POSITION_M = 300.0
FREE_SPEED_MPS = 30.0
FREE_TILT_RAD = 0.3
FREE_CLOCK_M = 1000.0  # larger jumps are removed before
FREE_DRIFT_MPS = 100.0
MOST_ROUNDS = 3  # a clock jump and a wrong prediction may come together


class RangeVerdict(Value, frozen=True):
    """What the tests found, and what of the epoch the filter may use.

    `motion` is the prediction, with what was found wrong of it forgotten (`prediction_freed`);
    `usable` are the innovations of those that are trusted, none where nothing is. `faulty` are
    indices of satellites found so; the statistic is that of the first round. `whole_system` says
    that a system is meant as a whole.
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
    """How many satellites may be left out: enough must stay for the set to be the only one."""
    # One satellite may be left out of four even so: the filter's prediction stands beside them.
    return max(min(wanted, (count - 4) // 2), 1 if count >= 4 else 0)


def pass_ranges(
    motion: MotionEstimate, modelled: Innovations, q: float, threshold: float
) -> RangeVerdict:
    """F00 passed: all ranges may be used."""
    return RangeVerdict(motion, "none", False, (), q, threshold, {}, modelled, False)


def isolate_ranges(
    motion: MotionEstimate,
    modelled: Innovations,
    q: float,
    threshold: float,
    standing_m: Vector,
    config: DetectorConfig,
    by_past: bool = False,
) -> RangeVerdict:
    """The verdict on ranges of `modelled` (n satellites) whose statistic q failed F00.

    `standing_m` (n,) is each satellite's learnt offset: where some are excluded it is subtracted
    from the rest, so that the position does not jump with the geometry. `by_past` judges them where
    F00 passed, too.
    """
    hypothesis, verdict, motion = _freed(motion, modelled, threshold, by_past, config)
    part = modelled
    if verdict.hypothesis == "satellites":
        # What was learnt while a whole system moved is its shift, and no offset of the others.
        part = without_satellites(modelled, verdict.subset, standing_m * (not verdict.whole_system))
    elif verdict.hypothesis != "none":
        part = NO_INNOVATIONS
    shown = hypothesis
    # An IMU found wrong earlier outweighs what is found of the rest.
    if verdict.hypothesis != "none" and hypothesis in ("none", "clock", SYSTEM_CLOCK):
        shown = verdict.hypothesis
    # Receivers set their clocks: that is shown, and is no alarm.
    alarm = shown not in ("none", "clock")
    shown = "clock" if shown == SYSTEM_CLOCK else shown
    subset, chances = verdict.subset, verdict.probabilities
    return RangeVerdict(
        motion, shown, alarm, subset, q, threshold, chances, part, True, verdict.whole_system
    )


def without_satellites(
    modelled: Innovations, subset: tuple[int, ...], standing_m: Vector
) -> Innovations:
    """The innovations of the satellites that are not in `subset`, their offsets `standing_m` (n,)
    subtracted."""
    keep = np.ones(len(modelled.v_m), dtype=bool)
    keep[list(subset)] = False
    part = modelled.select(keep)
    return part._replace(v_m=part.v_m - standing_m[keep])


def _freed(
    motion: MotionEstimate,
    modelled: Innovations,
    threshold: float,
    by_past: bool,
    config: DetectorConfig,
) -> tuple[str, IsolationVerdict, MotionEstimate]:
    """Judge what failed; forget the clock or the position where they explain it, and judge again.

    The hypothesis so far, the last verdict ("none" once what is left passes), and the filter. A
    prediction without an IMU claims little: its failure is a manoeuvre and no fault.
    """
    hypothesis = "none"
    chances: dict[str, float] = {}
    largest = largest_subset(len(modelled.v_m), config.left_out)
    # Contiguous, since a kernel is compiled anew for each memory layout.
    position = np.ascontiguousarray(modelled.h[:, 0:3])
    clock = np.ascontiguousarray(modelled.h[:, CLOCK : CLOCK + 1])
    systems = group_by_system(position, modelled.h[:, ISB:ERROR_SIZE])
    whole = False
    for number in range(MOST_ROUNDS):
        h, variance, v = modelled.h, modelled.variance, modelled.v_m
        asked = by_past and number == 0
        if not asked and innovation_statistic(motion.p, h, variance, v) <= threshold:
            return hypothesis, IsolationVerdict("none", (), chances, whole), motion
        m = inverse_covariance(motion.p, h, variance)
        p = config.p_false_alarm
        verdict = select_hypothesis(m, v, position, clock, p, largest, config.rule, systems)
        whole = whole or verdict.whole_system
        # The chances of the first round: those before anything was forgotten.
        chances = chances or verdict.probabilities
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
            return hypothesis, verdict._replace(probabilities=chances, whole_system=whole), motion
    # Three rounds did not settle it.
    return hypothesis, IsolationVerdict("multiple-unknown", (), chances, whole), motion


def free_clock(motion: MotionEstimate) -> MotionEstimate:
    """The filter with its clock forgotten: jumps of the receiver's clock are states."""
    p = motion.p.copy()
    p[CLOCK, CLOCK] += FREE_CLOCK_M**2
    p[DRIFT, DRIFT] += FREE_DRIFT_MPS**2
    return motion._replace(p=p)


def free_system_clocks(motion: MotionEstimate) -> MotionEstimate:
    """The filter with the systems' offsets forgotten; which clock left is not asked."""
    motion = free_clock(motion)
    p = motion.p.copy()
    p[range(ISB, ERROR_SIZE), range(ISB, ERROR_SIZE)] += FREE_CLOCK_M**2
    return motion._replace(p=p)


def free_position(motion: MotionEstimate) -> MotionEstimate:
    """The filter with its position and velocity forgotten, moved freely from here."""
    p = motion.p.copy()
    # Added, not set: what is unsure already does not become surer.
    for at, sigma in ((0, FREE_POSITION_M), (3, FREE_SPEED_MPS), (PSI, FREE_TILT_RAD)):
        p[range(at, at + 3), range(at, at + 3)] += sigma**2
    return motion._replace(p=p, inertial=False, alignment=None)
