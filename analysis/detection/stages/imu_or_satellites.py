"""All satellites or the IMU: which of them is faulty where they contradict each other.

Once ranges and rates of an epoch are combined to a fix, its clocks eliminated, the tests of a
receiver's own fix separate the two (`carry_off_windows`, `receiver_or_imu`). They are made for the
epochs of the last seconds, and only when the IMU is about to be isolated. docs/fdi.md, "Without raw
ranges", has the rules, also for satellites that stay excluded all together.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import EpochRecord
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import ERROR_SIZE, V
from analysis.detection.filter.information import NO_RATES
from analysis.detection.filter.measurement import Innovations
from analysis.detection.filter.propagation import predict
from analysis.detection.isolation.all_satellites import (
    position_shift,
    reject_all,
    velocity_shift,
)
from analysis.detection.isolation.epoch_statistics import LEAST_RATES
from analysis.detection.receiver.carry_off_windows import (
    LEAST_RATIO_LEAD,
    CarryOff,
    CarryOffDetection,
    CarryOffWindows,
    FixInnovation,
    compare_windows,
    extend_windows,
    find_significant_carry_off,
    fits_carry_off,
    new_windows,
    remove_carry_off,
    renew_oldest_window,
)
from analysis.detection.receiver.receiver_or_imu import (
    ALIKE_SHARE,
    INTERVALS,
    UNDECIDED,
    mean_force,
    unexplained_square,
)
from analysis.detection.stages.assess import Assessment, compare
from analysis.detection.stages.epoch_outcome import EpochVerdict
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.earth_kernel import local_axes
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

LIKELIER = 5.0  # by which an IMU, which fails more often than all satellites, must explain more
SPAN_US = 5_000_000  # of the epochs that are tested again
LEAST_EPOCHS = 5  # a filter that has just begun to use an IMU may have its attitude wrong


class EpochFix(NamedTuple):
    """An assessed epoch with north, east and down (3, 3) there, and its ranges and rates as a fix
    (None: they are too few)."""

    assessment: Assessment
    axes: Vector
    fix: FixInnovation | None


def isolate_source(
    assessment: Assessment,
    excluded_for: CarryOff | None,
    history: Sequence[EpochRecord],
    verdict: EpochVerdict,
    config: DetectorConfig,
) -> EpochVerdict:
    """The verdict on an epoch that an IMU has predicted, after every test that can be made.

    `excluded_for` is the carry-off for which all satellites are excluded already.
    """
    motion, ranges = assessment.prediction.motion, verdict.ranges
    by_gps = ranges.hypothesis == "gps"
    fix = _with_fix(assessment).fix if by_gps or excluded_for is not None else None
    if by_gps:  # how far the satellites are from the filter now, and the rate of that
        carried = None if fix is None else CarryOff(motion.t_us, fix.v[3:], fix.v[:3])
        return verdict._replace(source="gps", carry_off=carried)
    # First: satellites known to be wrong contradict the IMU at every epoch.
    if excluded_for and fix and fits_carry_off(excluded_for, motion.t_us, fix):
        return reject_satellites(verdict, motion, excluded_for)
    if "imu" not in (verdict.rates.hypothesis, ranges.hypothesis):
        return verdict
    source, detection = isolate_imu_or_satellites(history, assessment, config)
    if detection is None:
        return verdict._replace(source=source)
    return reject_satellites(verdict, remove_carry_off(motion, detection), detection.carried)


def reject_satellites(
    verdict: EpochVerdict, motion: MotionEstimate, carried: CarryOff
) -> EpochVerdict:
    """The verdict if all satellites are `carried` off: no measurement of the epoch is used, and the
    filter continues from `motion`."""
    rates = verdict.rates._replace(hypothesis="gps", usable=NO_RATES)
    ranges = reject_all(motion, verdict.ranges)
    return verdict._replace(rates=rates, ranges=ranges, source="gps", carry_off=carried)


def is_coasting(motion: MotionEstimate, innovations: Innovations) -> bool:
    """Whether a prediction knows the position less well than the ranges in use would on their own:
    a fault of the IMU itself would then go undetected."""
    _, alone = position_shift(innovations)
    return bool(np.trace(motion.p[:3, :3]) > np.trace(alone))


def isolate_imu_or_satellites(
    history: Sequence[EpochRecord], assessment: Assessment, config: DetectorConfig
) -> tuple[str, CarryOffDetection | None]:
    """`imu`, `gps` with the error that the filter has followed, or `GPS-or-imu`."""
    tests = _repeat_tests(history, assessment, config)
    if tests is None:
        return "imu", None
    windows, explained_by_force = tests
    by_carry_off, by_imu, detection = compare_windows(windows)
    if by_imu > by_carry_off + LIKELIER or explained_by_force:
        return "imu", None
    if by_carry_off > by_imu + LEAST_RATIO_LEAD:
        return "gps", detection
    return UNDECIDED, None


def find_slow_carry_off(
    history: Sequence[EpochRecord], assessment: Assessment, level: float, config: DetectorConfig
) -> CarryOffDetection | None:
    """A carry-off by all satellites while every test passed, if it is significant; `level` is the
    mean square of this flight's innovations."""
    tests = _repeat_tests(history, assessment, config)
    if tests is None:
        return None
    threshold = chi_square_threshold(3, config.p_slow)
    t_us = assessment.prediction.motion.t_us
    return find_significant_carry_off(tests[0], t_us, level, threshold)


def _repeat_tests(
    history: Sequence[EpochRecord], assessment: Assessment, config: DetectorConfig
) -> tuple[CarryOffWindows, bool] | None:
    """Carry-off windows over the last seconds, tested again, and whether the IMU's own force
    explains the last epoch; None where the epochs are too few, or their ranges are."""
    now = _with_fix(assessment)
    epochs = [*_last_epochs(history, assessment.prediction.motion.t_us, config), now]
    if len(epochs) < LEAST_EPOCHS:
        return None
    windows = new_windows(epochs[0].assessment.prediction.motion.t_us)
    for epoch in epochs:
        if epoch.fix is None:
            return None
        prediction = epoch.assessment.prediction
        t_us = prediction.motion.t_us
        windows = extend_windows(
            windows, t_us, prediction.dt_s, prediction.transition, epoch.axes, epoch.fix
        )
        if epoch is not now:
            windows = renew_oldest_window(windows, t_us)
    assert now.fix is not None
    assessments = [epoch.assessment for epoch in epochs]
    return windows, _is_explained_by_force(assessments, now.fix, config)


def _last_epochs(
    history: Sequence[EpochRecord], until_us: int, config: DetectorConfig
) -> list[EpochFix]:
    """The epochs of the last seconds, as far back as the IMU propagated the filter unbroken."""
    epochs: list[EpochFix] = []
    for record in reversed(history):
        epoch = None if record.t_us < until_us - SPAN_US else _assess_again(record, config)
        if epoch is None:
            break
        epochs.append(epoch)
    return epochs[::-1]


@lru_cache(maxsize=256)  # needed at one epoch, it is needed at the next ones too
def _assess_again(record: EpochRecord, config: DetectorConfig) -> EpochFix | None:
    """A past epoch; None where the IMU did not propagate the filter."""
    before = record.core.motion
    if before is None or not before.inertial:
        return None
    prediction = predict(before, record.run, record.t_us, config)
    if not prediction.motion.inertial:
        return None
    core = record.core
    return _with_fix(compare(record.observation, prediction, core, core.memory, config))


def _with_fix(assessment: Assessment) -> EpochFix:
    axes = local_axes(assessment.prediction.motion.x[:3])
    return EpochFix(assessment, axes, _combine_to_fix(assessment, axes))


def _combine_to_fix(assessment: Assessment, axes: Vector) -> FixInnovation | None:
    """Ranges and rates as a position and a velocity; None where they are too few."""
    innovations, p = assessment.innovations, assessment.prediction.motion.p
    statistics = assessment.statistics
    if statistics.rate_count < LEAST_RATES or len(statistics.ranges.v) < len(statistics.ranges.b):
        return None
    position, velocity = position_shift(innovations), velocity_shift(innovations)
    r = np.zeros((6, 6))
    r[:3, :3], r[3:, 3:] = axes @ position[1] @ axes.T, axes @ velocity[1] @ axes.T
    h = np.zeros((6, ERROR_SIZE))
    h[:3, :3], h[3:, V : V + 3] = axes, axes
    cross = p @ h.T
    m: Vector = np.linalg.inv(np.asarray(h @ cross + r, dtype=np.float64))
    v = np.r_[axes @ position[0], axes @ velocity[0]]
    return FixInnovation(v, np.arange(6), h, m, cross @ m)


def _is_explained_by_force(
    assessments: Sequence[Assessment], fix: FixInnovation, config: DetectorConfig
) -> bool:
    """Whether the IMU's force left its trend within the last intervals by the difference of the
    velocities."""
    segments = [one.prediction.segment for one in assessments[-2 - INTERVALS :]]
    forces = [force for force in map(mean_force, segments) if force is not None]
    if len(forces) < len(segments):
        return False
    prediction = assessments[-1].prediction
    motion, dt_s = prediction.motion, prediction.dt_s
    rot = local_axes(motion.x[:3]) @ rotation_matrix(motion.x[6:10])
    v_mps, sigma_mps = fix.v[3:], np.sqrt(np.diag(np.linalg.inv(fix.m))[3:])
    different = float(np.sum((v_mps / sigma_mps) ** 2))
    if different <= chi_square_threshold(3, config.p_other):
        return False  # there is nothing to explain at this epoch
    for since in range(1, len(forces) - 1):
        trend, before = forces[-since - 1] - forces[-since - 2], forces[-since - 1]
        changed_mps = rot @ (forces[-1] - before - since * trend) * dt_s
        if unexplained_square(v_mps, sigma_mps, changed_mps, since) <= ALIKE_SHARE**2 * different:
            return True
    return False
