"""Isolate: which hypothesis explains the tests of an epoch, and what the filter may use.

First the tests of the epoch alone: Doppler rates, ranges, the IMU against all satellites, a jump of
all satellites. Where these leave the prediction unbroken the tests with memory follow: they need
the filter's update by this epoch, which is kept for `commit` unless they reject it.
"""

from collections.abc import Sequence

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore, EpochRecord
from analysis.detection.filter.covariance_release import free_position, free_system_clocks
from analysis.detection.filter.information import update_filter
from analysis.detection.isolation.all_satellites import (
    common_jump_m,
    ranges_beyond_imu,
    rates_beyond_imu,
    reject_all,
)
from analysis.detection.isolation.common_shift import shift_is_suspected, shift_statistic
from analysis.detection.isolation.epoch_memory import learned_offsets_m
from analysis.detection.isolation.epoch_tests import isolate_ranges, run_range_test, run_rate_test
from analysis.detection.isolation.ramp_test import evaluate_ramps, new_ramps, prepare_ramps
from analysis.detection.isolation.ramp_windows import update_windows
from analysis.detection.receiver.carry_off_windows import LEAST_LEVEL, remove_carry_off
from analysis.detection.stages.assess import Assessment
from analysis.detection.stages.epoch_outcome import EpochVerdict, FilterUpdate
from analysis.detection.stages.imu_or_satellites import (
    find_slow_carry_off,
    isolate_imu_or_satellites,
    isolate_source,
    reject_satellites,
)
from analysis.samples.block import ImuRun

USABLE_PREDICTION = ("none", "satellites")  # verdicts of the rates that leave the prediction usable


def isolate(
    assessment: Assessment,
    core: DetectorCore,
    run: ImuRun,
    history: Sequence[EpochRecord],
    config: DetectorConfig,
) -> EpochVerdict:
    """The verdict on an assessed epoch; `run` are the IMU's samples since the last one, `history`
    the epochs before."""
    verdict = _isolate_by_epoch(assessment, core, run, history, config)
    before, ranges = assessment.prediction.before, verdict.ranges
    unbroken = not assessment.clock_jumped and not ranges.prediction_freed
    unbroken = unbroken and verdict.rates.hypothesis in USABLE_PREDICTION
    # Ramp tests need one unbroken filter: what was released or has jumped has no response.
    if unbroken and before.inertial == ranges.motion.inertial:
        return _isolate_by_memory(assessment, verdict, core, history, config)
    return verdict


def _isolate_by_epoch(
    assessment: Assessment,
    core: DetectorCore,
    run: ImuRun,
    history: Sequence[EpochRecord],
    config: DetectorConfig,
) -> EpochVerdict:
    """The verdict of the tests without memory."""
    prediction, trust = assessment.prediction, core.trust
    motion, innovations, statistics = (
        prediction.motion,
        assessment.innovations,
        assessment.statistics,
    )
    rates = run_rate_test(motion, innovations, statistics, config)
    runs = history[-1].run if history else None, run
    rates = rates_beyond_imu(rates, trust, prediction.before, motion, innovations, runs)
    offset_m = learned_offsets_m(assessment.memory.ramps, assessment.satellites)
    ranges = run_range_test(motion, innovations, statistics, rates.hypothesis, offset_m, config)
    ranges = ranges_beyond_imu(ranges, rates, motion)
    verdict = EpochVerdict(rates, ranges)
    if prediction.is_inertial:
        verdict = isolate_source(assessment, trust.carry_off, history, verdict, config)
    jump_m = common_jump_m(
        verdict.ranges, motion, innovations, statistics, prediction.dt_s, config.p_false_alarm
    )
    if jump_m is None:
        return verdict
    # All satellites that jumped together are used, and the filter follows.
    freed = free_system_clocks(free_position(motion))
    return verdict._replace(ranges=reject_all(freed, verdict.ranges, innovations), jump_m=jump_m)


def _isolate_by_memory(
    assessment: Assessment,
    verdict: EpochVerdict,
    core: DetectorCore,
    history: Sequence[EpochRecord],
    config: DetectorConfig,
) -> EpochVerdict:
    """The verdict on an epoch that passed its own tests, after those with memory."""
    prediction, ranges = assessment.prediction, verdict.ranges
    update = _update_with_ramps(assessment, verdict, config)
    verdict = verdict._replace(update=update)
    assert update.verdict is not None
    detection = None
    if prediction.before.inertial and update.verdict.hypothesis == "imu":
        source, detection = isolate_imu_or_satellites(history, assessment, config)
        verdict = verdict._replace(source=source)
    elif verdict.has_passed(assessment, config.doppler):
        known = core.memory.common_shift
        shift = shift_statistic(prediction.motion.p, assessment.statistics.rates)
        verdict = verdict._replace(shift=shift)
        if shift_is_suspected(known, shift, prediction.motion.t_us, config):
            level = max(known.level, LEAST_LEVEL)
            detection = find_slow_carry_off(history, assessment, level, config)
    if detection is not None:
        corrected = remove_carry_off(prediction.motion, detection)
        verdict = reject_satellites(verdict, corrected, detection.carried)
        return verdict._replace(update=FilterUpdate(corrected))
    if update.verdict.hypothesis != "satellites":
        return verdict
    # The ramp of one satellite may be better explained by its whole system.
    offset_m = learned_offsets_m(assessment.memory.ramps, assessment.satellites)
    q, threshold, used = ranges.statistic, ranges.threshold, assessment.innovations
    whole = isolate_ranges(ranges.motion, used, q, threshold, offset_m, config, by_past=True)
    return verdict._replace(ranges=whole, update=None) if whole.whole_system else verdict


def _update_with_ramps(
    assessment: Assessment, verdict: EpochVerdict, config: DetectorConfig
) -> FilterUpdate:
    """The filter after the usable measurements, and the ramp tests' verdict."""
    prediction, ranges = assessment.prediction, verdict.ranges
    motion, t_us = ranges.motion, prediction.motion.t_us
    ramps = assessment.memory.ramps or new_ramps(prediction.before.t_us)
    ramps = prepare_ramps(ramps, t_us, assessment.satellites, ranges.usable.variance, config)
    used, normal = ranges.usable, assessment.statistics.ranges
    if used is not assessment.innovations:
        normal = used.equations()
    update = update_filter(motion, normal, verdict.rates.usable)
    windows, strongest = update_windows(
        ramps.windows, motion, update, prediction.transition, prediction.dt_s, config
    )
    ramps = ramps._replace(windows=windows)
    return FilterUpdate(update.motion, ramps, evaluate_ramps(ramps, strongest, config))
