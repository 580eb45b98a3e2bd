"""Commit: the changes of the detector's state by an epoch whose verdict is known.

The filter uses the usable measurements; satellites are excluded and readmitted, the IMU is
suspended or used again; the position gets its bounds.
"""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.alignment import align_attitude
from analysis.detection.filter.covariance_release import free_position
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.information import update_filter
from analysis.detection.filter.lasting_errors import VarianceFactor
from analysis.detection.filter.measurement import NO_INNOVATIONS, Innovations
from analysis.detection.isolation.all_satellites import (
    COASTING_REASON,
    accumulated_jump_m,
    next_distrust,
    unbounded_reason,
)
from analysis.detection.isolation.common_shift import update_common_shift
from analysis.detection.isolation.epoch_memory import (
    EpochMemory,
    add_frozen,
    freeze_offsets,
    frozen_offsets_m,
)
from analysis.detection.isolation.epoch_statistics import parity_test
from analysis.detection.isolation.exclusion import (
    Exclusions,
    add_exclusions,
    innovations_of_excluded,
    readmit_satellites,
)
from analysis.detection.isolation.hypotheses import SYSTEMS_CONTRADICT
from analysis.detection.isolation.trust import LEAST_START_DOF, Trust
from analysis.detection.protection_levels import PositionBounds, bound_position
from analysis.detection.receiver.receiver_or_imu import UNDECIDED
from analysis.detection.stages.assess import Assessment
from analysis.detection.stages.epoch_outcome import (
    EpochOutcome,
    EpochVerdict,
    FilterUpdate,
    TestedEpoch,
    reported_hypothesis,
    update_suspension,
)
from analysis.detection.stages.imu_or_satellites import is_coasting

RATE_FAULT_EPOCHS = 3  # in a row, before a wrong rate alone is reported: one may be noise


def commit_untested(
    assessment: Assessment, core: DetectorCore, config: DetectorConfig
) -> EpochOutcome:
    """The core after an epoch with too few satellites to test: none of it is used, since an
    undetected fault would move the filter."""
    motion = assessment.prediction.motion
    memory = freeze_offsets(assessment.memory, motion.t_us, config)._replace(ramps=None)
    return EpochOutcome(core._replace(motion=motion, memory=memory), None, assessment.shortage)


def commit(
    assessment: Assessment, verdict: EpochVerdict, core: DetectorCore, config: DetectorConfig
) -> EpochOutcome:
    """The core after a tested epoch, and what the epoch showed."""
    prediction, ranges = assessment.prediction, verdict.ranges
    before, t_us = prediction.before, prediction.motion.t_us
    update, memory = _update(assessment, verdict, config)
    motion, ramps = update.motion, update.ramps
    imu_isolated = _isolates_imu(assessment, verdict)
    if imu_isolated and motion.inertial:
        motion = free_position(motion)
    excluded = innovations_of_excluded(
        assessment.excluded, assessment.excluded_innovations, prediction.motion, motion
    )
    remaining, standing = readmit_satellites(core.trust.excluded, excluded, t_us, config)
    trust = _update_trust(core.trust, assessment, verdict, remaining)
    if standing:
        memory = add_frozen(memory, standing, t_us, config)
    imu = update_suspension(core.imu, imu_isolated, t_us, config)
    motion = align_attitude(imu, motion, prediction.segment, prediction.dt_s, config)
    # To a filter without an IMU an acceleration was the vehicle's own: not an error of the IMU.
    if ramps is not None and motion.inertial and not before.inertial:
        ramps = ramps.without_accelerations()
    contradicting = trust.contradicting
    factor, bounds = _bound_position(assessment, verdict, memory, motion, contradicting, config)
    shift = memory.common_shift  # the usual level of the velocity that all rates share
    if verdict.has_passed(assessment, config.doppler):
        shift = update_common_shift(shift, verdict.shift, t_us, config)
    else:  # a test failed, or there is no IMU
        shift = shift._replace(suspected_until_us=0)
    memory = memory._replace(ramps=ramps, variance_factor=factor, common_shift=shift)
    timing = core.timing._replace(ranges_us=t_us)
    core = core._replace(motion=motion, imu=imu, trust=trust, memory=memory, timing=timing)
    core = _give_up(core, t_us, config)
    trust, silent = core.trust, before.inertial and prediction.segment.gap_s > config.gap_s
    # A silent IMU is reported like a faulty one: the prediction lacks it either way.
    imu_faulty = imu_isolated or silent
    tested = TestedEpoch(
        assessment,
        verdict,
        reported_hypothesis(trust, imu, ranges.hypothesis, imu_faulty, assessment.clock_jumped),
        ranges.alarm or imu_faulty,
        imu_isolated,
        bounds,
        _unbounded_reason(assessment, verdict, trust),
        excluded,
        tuple(name for name, count in trust.rate_faults.items() if count >= RATE_FAULT_EPOCHS),
    )
    return EpochOutcome(core, tested)


def _update(
    assessment: Assessment, verdict: EpochVerdict, config: DetectorConfig
) -> tuple[FilterUpdate, EpochMemory]:
    """The filter after the epoch, and the memory; the ramp tests' windows end where their update is
    not the one that is used, and the offsets that they have learned are frozen."""
    memory, ranges = assessment.memory, verdict.ranges
    if verdict.update is not None:
        return verdict.update, memory
    motion = update_filter(ranges.motion, ranges.usable.equations(), verdict.rates.usable).motion
    # Offsets learned while a whole system moves are its shift, not offsets of satellites.
    if not ranges.whole_system:
        memory = freeze_offsets(memory, motion.t_us, config)
    return FilterUpdate(motion), memory


def _isolates_imu(assessment: Assessment, verdict: EpochVerdict) -> bool:
    """Whether a test isolates the IMU; a failed prediction without an IMU is a manoeuvre."""
    ramps = verdict.ramps
    hypotheses = (verdict.rates.hypothesis, verdict.ranges.hypothesis, ramps and ramps.hypothesis)
    return assessment.prediction.before.inertial and "imu" in hypotheses


def _update_trust(
    trust: Trust,
    assessment: Assessment,
    verdict: EpochVerdict,
    remaining: Exclusions,
) -> Trust:
    """Which sources are believed after the epoch; satellites in `remaining` stay excluded."""
    ranges, t_us = verdict.ranges, assessment.prediction.motion.t_us
    names, jumped = assessment.satellites, verdict.jump_m is not None
    imu_isolated = _isolates_imu(assessment, verdict)
    # Satellites known to mislead the filter, which follows them all the same, are no evidence
    # against the IMU.
    undecided = imu_isolated and (trust.misled or verdict.source == UNDECIDED)
    is_imu = imu_isolated and not undecided  # then it was the IMU before, too
    faulty = tuple(names[i] for i in ranges.faulty)
    unexplained = ranges.hypothesis in ("multiple-unknown", "gps") and not jumped and not faulty
    # A satellite that the ranges isolate too is reported as excluded.
    wrong_rates = [names[i] for i in verdict.rates.faulty if i not in ranges.faulty]
    excluded = add_exclusions(remaining, faulty, t_us, t_us, ranges.whole_system)
    contradicting = trust.contradicting
    if faulty and ranges.hypothesis == "multiple-unknown":
        contradicting = "".join(sorted({*contradicting, *(name[0] for name in faulty)}))
    if not any(name[0] in contradicting for name in excluded):
        contradicting = ""
    return Trust(
        excluded=excluded,
        # The first epoch of several counts.
        unexplained_since_us=(trust.unexplained_since_us or t_us) if unexplained else None,
        distrusted="" if jumped else next_distrust(trust.distrusted, verdict.rates, ranges),
        carry_off=verdict.carry_off if ranges.hypothesis == "gps" and not jumped else None,
        jump_m=accumulated_jump_m(trust.jump_m, verdict.jump_m),
        unbounded=(trust.unbounded or undecided) and not is_imu,
        misled=trust.misled,
        rate_faults={name: trust.rate_faults.get(name, 0) + 1 for name in wrong_rates},
        to_confirm=max(trust.to_confirm - _confirms_start(assessment, verdict), 0),
        contradicting=contradicting,
    )


def _confirms_start(assessment: Assessment, verdict: EpochVerdict) -> bool:
    """Whether the epoch tests a start again: with more satellites, or by its Doppler rates."""
    rates = verdict.rates
    if rates.hypothesis != "none":
        return False
    # More rates than velocity and drift have unknowns test the place that they were predicted for.
    return rates.dof > 4 or assessment.statistics.parity_dof >= LEAST_START_DOF


def _give_up(core: DetectorCore, t_us: int, config: DetectorConfig) -> DetectorCore:
    """The core without its filter where nothing has explained the ranges for too long."""
    trust = core.trust
    unexplained = trust.unexplained_since_us is not None or trust.jump_m is not None
    if trust.to_confirm and (trust.excluded or unexplained):
        # A start that nothing has confirmed is no ground to exclude what contradicts it.
        trust = Trust(misled=trust.misled, unbounded=trust.unbounded)
        return core._replace(motion=None, trust=trust, memory=core.memory._replace(ramps=None))
    since_us = trust.unexplained_since_us
    if since_us is None or (t_us - since_us) * 1e-6 < config.reset_s:
        return core
    # Distrusted satellites are followed from here on, as there is no other source of position.
    distrusted = trust.distrusted != ""
    trust = trust._replace(
        unexplained_since_us=None,
        distrusted="",
        carry_off=None,
        unbounded=trust.unbounded or distrusted,
        misled=trust.misled or distrusted,
    )
    return core._replace(motion=None, trust=trust, memory=core.memory._replace(ramps=None))


def _unbounded_reason(assessment: Assessment, verdict: EpochVerdict, trust: Trust) -> str:
    """Why nothing bounds the position; empty where something does."""
    ranges = verdict.ranges
    if ranges.whole_system and ranges.hypothesis == "multiple-unknown" and not ranges.faulty:
        return SYSTEMS_CONTRADICT
    motion = assessment.prediction.motion
    if verdict.carry_off is not None and is_coasting(motion, assessment.innovations):
        return COASTING_REASON
    return unbounded_reason(trust)


def _bound_position(
    assessment: Assessment,
    verdict: EpochVerdict,
    memory: EpochMemory,
    motion: MotionEstimate,
    contradicting: str,
    config: DetectorConfig,
) -> tuple[VarianceFactor, PositionBounds]:
    """How well the ranges have fitted, and the bounds of the position after the epoch, by the
    satellites that were not found faulty, and by those of the systems `contradicting` them."""
    prediction, statistics = assessment.prediction, assessment.statistics
    names, innovations = assessment.satellites, assessment.innovations
    faulty, parity, dof = verdict.ranges.faulty, statistics.parity, statistics.parity_dof
    if faulty:
        names = tuple(name for i, name in enumerate(names) if i not in faulty)
        innovations = innovations.without(faulty)
        parity, dof, _ = parity_test(innovations.equations())
    since_us = motion.t_us - prediction.before.t_us
    factor = memory.variance_factor.with_epoch(parity, dof, since_us * 1e-6)
    moved_m = motion.x[:3] - prediction.motion.x[:3]
    offset_m = frozen_offsets_m(memory.frozen, names, motion.t_us, config)
    share = config.sigma.slow**2
    rivals = NO_INNOVATIONS
    if contradicting:
        pairs = zip(assessment.innovations, assessment.excluded_innovations, strict=True)
        both = (*assessment.satellites, *assessment.excluded)
        rivals = Innovations(*map(np.concatenate, pairs)).select(
            np.array([name[0] in contradicting for name in both])
        )
    return factor, bound_position(
        innovations, moved_m, offset_m, motion.x[:3], factor, share, rivals
    )
