"""All satellites at once: what no IMU can do to the prediction is the signals' doing, or the
receiver's.

An IMU's fault reaches the position through the velocity, and the velocity through a force that is
wrong. So a position that leaves while the Doppler rates still fit, or a velocity that leaves faster
than a wrongly turned force could drive it while the IMU's own output did not change, or both where
the place is farther off than that velocity could have led it, is not the IMU's. The satellites
agree among themselves: the hypothesis is `gps`, and nothing of the epoch is used.

Without an IMU a place that leaps as no vehicle does, while the satellites agree, is `gps` too. The
filter follows, as nothing else tells where it is, but nothing bounds the position until the
satellites have leapt back.
"""

import numpy as np

from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import CLOCK, ERROR_SIZE
from analysis.detection.filter.measurement import NO_INNOVATIONS, Innovations
from analysis.detection.isolation.assessment import EpochStatistics
from analysis.detection.isolation.chi_square import chi_square_threshold
from analysis.detection.isolation.range_test import RangeVerdict, free_position, free_system_clocks
from analysis.detection.isolation.rate_test import NO_RATES, RateVerdict
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector

RANGES_DISTRUSTED, RATES_DISTRUSTED = "ranges", "rates"  # what of all satellites is distrusted
LEAST_SHIFT_M = 10.0  # a smaller shift may be the geometry's, when other satellites are used
VELOCITY_SLACK_MPS = 0.5  # of the velocity, for noise and for what has come together before
JUMP_M, JUMP_MPS2 = 30.0, 50.0  # geometry and multipath; five times gravity is no vehicle's
JUMP_SIGMAS = 5.0  # of the prediction
AGREEING_DOF = 3  # that the satellites must agree by
JUMP_REASON = "all satellites leapt together, and nothing tells which place is right"
COASTING_REASON = (
    "all satellites are left out: the IMU alone carries the position, and nothing bounds it"
)
FOLLOWED_REASON = (
    "all satellites or the IMU are wrong: the position is the satellites', without a bound"
)


def rates_beyond_imu(
    rates: RateVerdict,
    core: DetectorCore,
    motion: MotionEstimate,
    used: Innovations,
    runs: tuple[ImuRun | None, ImuRun],
) -> RateVerdict:
    """The rates' verdict; `gps` where it blames an IMU that cannot have done it, or that was sound
    when the satellites began to lie.

    `runs` are what the IMU gave in the interval before, where that is known, and in this one.
    """
    if not motion.inertial:
        return rates
    wrong = core.distrusted == RATES_DISTRUSTED
    if rates.hypothesis == "imu" and (
        core.distrusted or _faster_than_force(used, *runs) or _leapt(core, motion, used)
    ):
        return RateVerdict(rates.statistic, rates.threshold, rates.dof, "gps", NO_RATES)
    return rates._replace(fit=NO_RATES) if wrong else rates  # used again once the ranges fit too


def next_distrust(core: DetectorCore, rates: RateVerdict, tested: RangeVerdict) -> str:
    """What is distrusted of all satellites after an epoch."""
    if tested.hypothesis != "gps":
        return ""
    return (
        RATES_DISTRUSTED
        if rates.hypothesis == "gps" or core.distrusted == RATES_DISTRUSTED
        else RANGES_DISTRUSTED
    )


def _faster_than_force(used: Innovations, before: ImuRun | None, run: ImuRun) -> bool:
    """Whether the velocity left faster than what the IMU measured could drive it."""
    if before is None or len(run.t_us) < 2 or len(before.t_us) < 2:
        return False
    force, force_before = run.values[:, 3:6].mean(axis=0), before.values[:, 3:6].mean(axis=0)
    if not np.isfinite(force + force_before).all():
        return False
    dt_s = float(run.t_us[-1] - before.t_us[-1]) * 1e-6
    columns = np.column_stack([used.h[:, 0:3], np.ones(len(used.v_mps))])
    grown_mps = np.linalg.norm(_shift(columns, used.v_mps, used.rate_variance))
    changed_mps = np.linalg.norm(force - force_before) * dt_s
    turned_mps = max(np.linalg.norm(force), np.linalg.norm(force_before)) * dt_s
    return bool(grown_mps > turned_mps + changed_mps + VELOCITY_SLACK_MPS)


def _leapt(core: DetectorCore, motion: MotionEstimate, used: Innovations) -> bool:
    """Whether the place is farther off than the velocity that is wrong could have led it since the
    ranges were used."""
    assert core.motion is not None
    dt_s = (motion.t_us - (core.unknown_since_us or core.motion.t_us)) * 1e-6
    clocks = used.h[:, CLOCK:ERROR_SIZE]
    place = np.hstack([used.h[:, :3], clocks[:, clocks.any(axis=0)]])
    speed = np.column_stack([used.h[:, :3], np.ones(len(used.v_mps))])
    shift_m = np.linalg.norm(_shift(place, used.v_m, used.variance))
    led_m = 2.0 * dt_s * np.linalg.norm(_shift(speed, used.v_mps, used.rate_variance))
    unsure_m = JUMP_SIGMAS * np.sqrt(np.trace(motion.p[:3, :3]))
    return bool(shift_m > LEAST_SHIFT_M + led_m + unsure_m)


def ranges_beyond_imu(
    tested: RangeVerdict,
    rates: RateVerdict,
    core: DetectorCore,
    motion: MotionEstimate,
    used: Innovations,
) -> RangeVerdict:
    """The ranges' verdict; `gps` where it blames an IMU whose velocity the rates confirm.

    `motion` is the prediction before anything of it was forgotten.
    """
    confirmed = rates.statistic is not None and rates.hypothesis == "none"
    if rates.hypothesis != "gps":
        if not (confirmed and motion.inertial and tested.hypothesis == "imu"):
            return tested
        columns = np.column_stack([used.h[:, 0:3], used.h[:, CLOCK]])
        shift_m = np.linalg.norm(_shift(columns, used.v_m, used.variance))
        if shift_m < LEAST_SHIFT_M and not core.distrusted:
            return tested
    return reject_all(motion, tested)


def reject_all(motion: MotionEstimate, tested: RangeVerdict) -> RangeVerdict:
    """The ranges' verdict where all satellites lie: nothing of the epoch is used."""
    return RangeVerdict(
        motion, "gps", True, (), tested.statistic, tested.threshold, tested.probabilities,
        NO_INNOVATIONS, True,
    )  # fmt: skip


def common_jump_m(
    tested: RangeVerdict,
    motion: MotionEstimate,
    used: Innovations,
    tests: EpochStatistics,
    dt_s: float,
    p_agree: float,
) -> Vector | None:
    """How far (3,) all satellites together have leapt, where no vehicle has, else None.

    `motion` is the prediction over `dt_s`, `tested` what the main test says of it, `p_agree` the
    false-alarm probability of the test whether the satellites agree.
    """
    explained = tested.hypothesis == "satellites" or tested.whole_system
    if motion.inertial or not tested.prediction_freed or explained:
        return None
    dof = tests.parity_dof
    if dof < AGREEING_DOF or tests.parity > chi_square_threshold(dof, p_agree):
        return None
    clocks = used.h[:, CLOCK:ERROR_SIZE]
    shift_m = _shift(
        np.hstack([used.h[:, :3], clocks[:, clocks.any(axis=0)]]), used.v_m, used.variance
    )
    unsure_m = JUMP_SIGMAS * np.sqrt(np.trace(motion.p[:3, :3]))
    most_m = JUMP_M + 0.5 * JUMP_MPS2 * dt_s**2 + unsure_m
    return shift_m if np.linalg.norm(shift_m) > most_m else None


def follow_jump(tested: RangeVerdict, motion: MotionEstimate, used: Innovations) -> RangeVerdict:
    """The verdict on satellites that leapt together: all are followed."""
    free = free_system_clocks(free_position(motion))
    chances = tested.probabilities
    return RangeVerdict(
        free, "gps", True, (), tested.statistic, tested.threshold, chances, used, True
    )  # fmt: skip


def accumulated_jump_m(so_far_m: Vector | None, shift_m: Vector | None) -> Vector | None:
    """How far (3,) the satellites have leapt since they were where they belong; None: not at all.

    A leap back ends it: as far as geometry and the vehicle's own motion let it.
    """
    if shift_m is None:
        return so_far_m
    total_m = shift_m if so_far_m is None else so_far_m + shift_m
    return total_m if np.linalg.norm(total_m) > 0.5 * np.linalg.norm(shift_m) else None


def _shift(columns: Vector, v: Vector, variance: Vector) -> Vector:
    """What moves all of some innovations v (n,): the weighted solution's first three (3,)."""
    known = np.isfinite(v)
    weight = 1.0 / np.sqrt(variance[known])
    solution = np.linalg.lstsq(columns[known] * weight[:, np.newaxis], v[known] * weight)[0]
    return np.asarray(solution[:3], dtype=np.float64)
