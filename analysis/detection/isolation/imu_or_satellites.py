"""All satellites or the IMU: who is wrong where they contradict each other.

A spoofer of all signals moves ranges and Doppler rates together, as a wrong IMU seems to. What
tells them apart without raw ranges does so with them (`carry_off`, `receiver_or_imu`), once an
epoch's ranges and rates are put together as a fix: its clocks are eliminated, with N and b of
`information` in blocks of position p and clocks c,

    N_p = N_pp - N_pc inv(N_cc) N_cp,   b_p = b_p - N_pc inv(N_cc) b_c,   v = inv(N_p) b_p,

and the rates in the same way. So that nobody pays for it while all is well, the epochs of the last
seconds are asked once more when the IMU is about to be blamed. Where its own force changed by what
the velocities differ by, or a wrong force or rate explains more than a steady drag, it is the IMU;
where the drag does, the satellites; else one of them, the IMU if it was wrong before.

Satellites that were left out all together fit again soon, as the filter grows unsure without them.
They stay out for as long as they are nearer to where they had led it than to the filter.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import DetectorCore, EpochRecord
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import CLOCK, ERROR_SIZE, V
from analysis.detection.filter.measurement import Innovations
from analysis.detection.filter.offsets import frozen_offsets_m
from analysis.detection.filter.propagation import ImuSegment, propagate_filter
from analysis.detection.isolation.all_satellites import reject_all
from analysis.detection.isolation.assessment import LEAST_RATES, see
from analysis.detection.isolation.chi_square import chi_square_threshold
from analysis.detection.isolation.range_test import RangeVerdict
from analysis.detection.isolation.rate_test import NO_RATES, RateVerdict
from analysis.detection.receiver.carry_off_windows import (
    LEAST_RATIO_LEAD,
    WITH_TURNS,
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
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

LIKELIER = 5.0  # by which an IMU, which fails oftener than all satellites, must explain more
SPAN_US = 5_000_000  # that is asked once more
FEWEST = 5  # epochs: a filter that has just begun to use an IMU may have its attitude wrong


class Moment(NamedTuple):
    """An epoch: the filter that the IMU's `part` has predicted for it, over `dt_s` by the
    transition phi (20, 20), and the innovations."""

    motion: MotionEstimate
    phi: Vector
    dt_s: float
    used: Innovations
    part: ImuSegment


class Tells(NamedTuple):
    """A moment with north, east and down (3, 3) there, and its ranges and rates as a fix."""

    moment: Moment
    axes: Vector
    fix: FixInnovation | None


class Blame(NamedTuple):
    """The verdicts of rates and ranges; who is at fault where they blame the IMU, or where both are
    `gps`, by what the satellites lead the filter off."""

    rates: RateVerdict
    tested: RangeVerdict
    accused: str = "imu"
    carried: CarryOff | None = None


class Asked(NamedTuple):
    """Windows over the last seconds; whether the IMU's own force explains the last epoch."""

    carry: CarryOffWindows
    its_own_force: bool


def by_whom(
    core: DetectorCore,
    past: Sequence[EpochRecord],
    now: Moment,
    rates: RateVerdict,
    tested: RangeVerdict,
    config: DetectorConfig,
) -> Blame:
    """The verdicts on an epoch where an IMU moved the filter, after all that can be asked."""
    if tested.hypothesis == "gps":
        return Blame(rates, tested, "gps", _carried_now(now))
    # First of all: whoever lies already accuses the IMU at every epoch.
    stays_out = _stays_out(core, now)
    if "imu" in (rates.hypothesis, tested.hypothesis) and not stays_out:
        who, found = accused(past, now, config)
        if found is None:
            return Blame(rates, tested, who)
        return led_off(found, now, rates, tested)
    if not stays_out:
        return Blame(rates, tested)
    lying = rates._replace(hypothesis="gps", fit=NO_RATES)
    return Blame(lying, reject_all(now.motion, tested), "gps", core.carried)


def _stays_out(core: DetectorCore, now: Moment) -> bool:
    """Whether satellites that were left out all together lie where they led."""
    if core.carried is None:
        return False
    fix = _as_fix(now, _axes(now.motion))
    return fix is not None and fits_carry_off(core.carried, now.motion.t_us, fix)


def led_off(
    found: CarryOffDetection, now: Moment, rates: RateVerdict, tested: RangeVerdict
) -> Blame:
    """The verdicts where all satellites have led the filter off: nothing of the epoch is used, and
    what the filter has followed is taken back."""
    lying = rates._replace(hypothesis="gps", fit=NO_RATES)
    return Blame(
        lying, reject_all(remove_carry_off(now.motion, found), tested), "gps", found.carried
    )


def coasts(motion: MotionEstimate, used: Innovations) -> bool:
    """Whether a prediction knows the place less well than the ranges in use would on their own: an
    IMU's own fault would then be seen by nobody."""
    clocks = used.h[:, CLOCK:]
    clocks = clocks[:, clocks.any(axis=0)]
    _, alone = _eliminated(used.h[:, :3], clocks, used.v_m, used.variance)
    return bool(np.trace(motion.p[:3, :3]) > np.trace(alone))


def _carried_now(now: Moment) -> CarryOff | None:
    """How far the satellites are off the filter, and how fast they go on."""
    fix = _as_fix(now, _axes(now.motion))
    return None if fix is None else CarryOff(now.motion.t_us, fix.v[3:], fix.v[:3])


def accused(
    past: Sequence[EpochRecord], now: Moment, config: DetectorConfig
) -> tuple[str, CarryOffDetection | None]:
    """`imu`, `gps` with what the filter has followed, or `GPS-or-imu`."""
    asked = _asked(past, now, config)
    if asked is None:
        return "imu", None
    dragged, pushed, found = compare_windows(asked.carry)
    if pushed > dragged + LIKELIER or asked.its_own_force:
        return "imu", None
    if dragged > pushed + LEAST_RATIO_LEAD:
        return "gps", found
    return ("imu" if _was_wrong(past) else UNDECIDED), None


def led_slowly(
    past: Sequence[EpochRecord], now: Moment, level: float, config: DetectorConfig
) -> CarryOffDetection | None:
    """What all satellites have led the filter off while every test passed, if that is clear;
    `level` is the mean square of this flight's innovations."""
    asked = _asked(past, now, config)
    if asked is None or asked.its_own_force:
        return None
    return find_significant_carry_off(
        asked.carry, now.motion.t_us, level, chi_square_threshold(3, config.p_slow)
    )


def _asked(past: Sequence[EpochRecord], now: Moment, config: DetectorConfig) -> Asked | None:
    """The last seconds once more; None where they are too few or tell too little."""
    told = [*_told(past, now.motion.t_us, config), _tells(now)]
    if len(told) < FEWEST:
        return None
    moments = [tells.moment for tells in told]
    carry, fix = new_windows(moments[0].motion.t_us, WITH_TURNS), None
    for moment, axes, fix in told:
        motion = moment.motion
        if fix is None:
            return None
        carry = extend_windows(carry, motion.t_us, moment.dt_s, moment.phi, axes, fix)
        if moment is not now:
            carry = renew_oldest_window(carry, motion.t_us)
    assert fix is not None
    return Asked(carry, _its_own_force(moments, fix, config))


def _was_wrong(past: Sequence[EpochRecord]) -> bool:
    """Whether the IMU was found wrong within what is remembered: then it most likely is again."""
    cores = [record.core for record in past]
    return any(core.imu_bad_until_us is not None and not core.unbounded for core in cores)


def _told(past: Sequence[EpochRecord], until_us: int, config: DetectorConfig) -> list[Tells]:
    """The last seconds, as far back as the IMU moved the filter without a break."""
    found: list[Tells] = []
    for record in reversed(past):
        tells = None if record.t_us < until_us - SPAN_US else _remembered(record, config)
        if tells is None:
            break
        found.append(tells)
    return found[::-1]


@lru_cache(maxsize=256)  # asked at one epoch, it is asked at the next ones too
def _remembered(record: EpochRecord, config: DetectorConfig) -> Tells | None:
    """An epoch once more; None where the IMU did not move the filter."""
    core, before = record.core, record.core.motion
    if before is None or not before.inertial:
        return None
    part = record.part
    motion, phi = propagate_filter(before, part, record.t_us, config)
    if not motion.inertial:
        return None
    names = record.observed.satellites
    trusted = np.array([name not in core.excluded for name in names], dtype=bool)
    offset_m = frozen_offsets_m(core, names, record.t_us, config)
    sight = see(record.observed, trusted, offset_m, motion, core.ionosphere, config)
    dt_s = (record.t_us - before.t_us) * 1e-6
    return _tells(Moment(motion, phi, dt_s, sight.used, part))


def _tells(moment: Moment) -> Tells:
    axes = _axes(moment.motion)
    return Tells(moment, axes, _as_fix(moment, axes))


def _axes(motion: MotionEstimate) -> Vector:
    """North, east and down (3, 3) in ECEF."""
    lat, lon, _ = geodetic_position(motion.x[:3])
    axes: Vector = ned_axes(lat, lon)
    return axes


def _as_fix(moment: Moment, axes: Vector) -> FixInnovation | None:
    """Ranges and rates as a position and a velocity; None where they are too few."""
    used, p = moment.used, moment.motion.p
    known = np.isfinite(used.v_mps)
    clocks = used.h[:, CLOCK:]
    clocks = clocks[:, clocks.any(axis=0)]
    if known.sum() < LEAST_RATES or len(used.v_m) < 3 + clocks.shape[1]:
        return None
    ones = np.ones((int(known.sum()), 1))
    place = _eliminated(used.h[:, :3], clocks, used.v_m, used.variance)
    speed = _eliminated(used.h[known, :3], ones, used.v_mps[known], used.rate_variance[known])
    r = np.zeros((6, 6))
    r[:3, :3], r[3:, 3:] = axes @ place[1] @ axes.T, axes @ speed[1] @ axes.T
    h = np.zeros((6, ERROR_SIZE))
    h[:3, :3], h[3:, V : V + 3] = axes, axes
    cross = p @ h.T
    m: Vector = np.linalg.inv(np.asarray(h @ cross + r, dtype=np.float64))
    return FixInnovation(np.r_[axes @ place[0], axes @ speed[0]], np.arange(6), h, m, cross @ m)


def _eliminated(h: Vector, clocks: Vector, v: Vector, variance: Vector) -> tuple[Vector, Vector]:
    """A vector (3,) and its covariance (3, 3) by innovations v (n,) whose clocks are unknown."""
    columns = np.hstack([h, clocks]) / np.sqrt(variance)[:, None]
    # Pseudo-inverse: satellites in one direction leave an axis without information.
    cofactor: Vector = np.asarray(np.linalg.pinv(columns.T @ columns, hermitian=True), np.float64)
    return (cofactor @ columns.T @ (v / np.sqrt(variance)))[:3], cofactor[:3, :3]


def _its_own_force(moments: Sequence[Moment], fix: FixInnovation, config: DetectorConfig) -> bool:
    """Whether the IMU's force left its trend within the last intervals by what the velocities
    differ."""
    asked = [mean_force(moment.part) for moment in moments[-2 - INTERVALS :]]
    forces = [force for force in asked if force is not None]
    if len(forces) < len(asked):
        return False
    motion = moments[-1].motion
    rot, dt_s = _axes(motion) @ rotation_matrix(motion.x[6:10]), moments[-1].dt_s
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
