"""All satellites at once: innovations that no IMU fault can cause come from the signals or the
receiver.

An IMU fault reaches the position through the velocity, and the velocity through a wrong force; what
arrives otherwise is `gps`, and nothing of the epoch is used. Without an IMU a position that jumps
as no vehicle can is `gps` too. docs/fdi.md has the rules.
"""

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import CLOCK
from analysis.detection.filter.information import NO_RATES
from analysis.detection.filter.measurement import NO_INNOVATIONS, Innovations
from analysis.detection.isolation.epoch_statistics import EpochStatistics
from analysis.detection.isolation.epoch_tests import RangeVerdict, RateVerdict
from analysis.detection.isolation.trust import TRUSTED_DOF, Trust, awaited_confirmation
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector

RANGES_DISTRUSTED, RATES_DISTRUSTED = "ranges", "rates"  # values of `Trust.distrusted`
JUMP_M, JUMP_MPS2 = 30.0, 50.0  # geometry and multipath; five times gravity: no vehicle does more
JUMP_SIGMAS = 5.0  # of the prediction: 6e-7 by chance
JUMP_REASON = "all satellites jumped together: it is unknown which position is right"
COASTING_REASON = "all satellites are excluded: the position is the IMU's alone, without a bound"
FOLLOWED_REASON = (
    "satellites or IMU are faulty, which is unknown: the position follows the satellites, "
    "without a bound"
)


def rates_beyond_imu(
    rates: RateVerdict,
    trust: Trust,
    before: MotionEstimate,
    motion: MotionEstimate,
    innovations: Innovations,
    runs: tuple[ImuRun | None, ImuRun],
) -> RateVerdict:
    """The verdict of the rate test, with `imu` changed to `gps` if the IMU cannot be the cause or
    was healthy when the satellites became faulty.

    `before` is the filter at the last epoch, `motion` the prediction; `runs` are the IMU samples
    of the previous interval, if known, and of this one.
    """
    if not motion.inertial:
        return rates
    if rates.hypothesis == "imu" and (
        trust.distrusted
        or _is_faster_than_force(innovations, *runs)
        or _has_jumped(trust.unexplained_since_us or before.t_us, motion, innovations)
    ):
        return RateVerdict(rates.statistic, rates.threshold, rates.dof, "gps", NO_RATES)
    # Rates that were wrong are used again once the ranges fit too.
    wrong = trust.distrusted == RATES_DISTRUSTED
    return rates._replace(usable=NO_RATES) if wrong else rates


def unbounded_reason(trust: Trust) -> str:
    """Why nothing bounds the position, by what is believed; empty where something does."""
    if trust.jump_m is not None:
        return JUMP_REASON
    return FOLLOWED_REASON if trust.unbounded else awaited_confirmation(trust.to_confirm)


def next_distrust(distrusted: str, rates: RateVerdict, ranges: RangeVerdict) -> str:
    """Which measurements of all satellites are distrusted after an epoch."""
    if ranges.hypothesis != "gps":
        return ""
    by_rates = rates.hypothesis == "gps" or distrusted == RATES_DISTRUSTED
    return RATES_DISTRUSTED if by_rates else RANGES_DISTRUSTED


def _is_faster_than_force(innovations: Innovations, before: ImuRun | None, run: ImuRun) -> bool:
    """Whether the velocity shift grew faster than the IMU's specific force can explain."""
    if before is None or len(run.t_us) < 2 or len(before.t_us) < 2:
        return False
    force, force_before = run.values[:, 3:6].mean(axis=0), before.values[:, 3:6].mean(axis=0)
    if not np.isfinite(force + force_before).all():
        return False
    dt_s = float(run.t_us[-1] - before.t_us[-1]) * 1e-6
    grown_mps = np.linalg.norm(velocity_shift(innovations)[0])
    changed_mps = np.linalg.norm(force - force_before) * dt_s
    turned_mps = max(np.linalg.norm(force), np.linalg.norm(force_before)) * dt_s
    return bool(grown_mps > turned_mps + changed_mps)


def _has_jumped(since_us: int, motion: MotionEstimate, innovations: Innovations) -> bool:
    """Whether the position is farther off than the wrong velocity could have carried it since the
    ranges were last used: on a walk both systems are carried off (benchmarks/gnss_spoofs.py)."""
    dt_s = (motion.t_us - since_us) * 1e-6
    shift_m = np.linalg.norm(position_shift(innovations)[0])
    carried_m = 2.0 * dt_s * np.linalg.norm(velocity_shift(innovations)[0])
    uncertain_m = JUMP_SIGMAS * np.sqrt(np.trace(motion.p[:3, :3]))
    return bool(shift_m > carried_m + uncertain_m)


def ranges_beyond_imu(
    ranges: RangeVerdict, rates: RateVerdict, motion: MotionEstimate
) -> RangeVerdict:
    """The ranges' verdict; `gps` where it isolates an IMU whose velocity the rates confirm.

    `motion` is the prediction before any of it was released.
    """
    confirmed = motion.inertial and rates.statistic is not None and rates.hypothesis == "none"
    beyond = confirmed and ranges.hypothesis == "imu"
    return reject_all(motion, ranges) if beyond or rates.hypothesis == "gps" else ranges


def reject_all(
    motion: MotionEstimate, ranges: RangeVerdict, usable: Innovations = NO_INNOVATIONS
) -> RangeVerdict:
    """The ranges' verdict where all satellites are wrong: nothing of the epoch is used, or only
    what is `usable` all the same."""
    changes = {"hypothesis": "gps", "alarm": True, "faulty": (), "whole_system": False}
    return ranges._replace(motion=motion, usable=usable, prediction_freed=True, **changes)


def common_jump_m(
    ranges: RangeVerdict,
    motion: MotionEstimate,
    innovations: Innovations,
    statistics: EpochStatistics,
    dt_s: float,
    p_agree: float,
) -> Vector | None:
    """How far (3,) all satellites have jumped together if no vehicle moves so far, else None.

    `motion` is the prediction over `dt_s`, `ranges` the verdict on it, `p_agree` the false-alarm
    probability of the test whether the satellites agree.
    """
    explained = ranges.hypothesis == "satellites" or ranges.whole_system
    if motion.inertial or not ranges.prediction_freed or explained:
        return None
    dof = statistics.parity_dof
    if dof < TRUSTED_DOF or statistics.parity > chi_square_threshold(dof, p_agree):
        return None
    shift_m, _ = position_shift(innovations)
    uncertain_m = JUMP_SIGMAS * np.sqrt(np.trace(motion.p[:3, :3]))
    most_m = JUMP_M + 0.5 * JUMP_MPS2 * dt_s**2 + uncertain_m
    return shift_m if np.linalg.norm(shift_m) > most_m else None


def accumulated_jump_m(so_far_m: Vector | None, shift_m: Vector | None) -> Vector | None:
    """How far (3,) the satellites have jumped in all; None where they are back.

    A jump back ends it, as accurately as geometry and the vehicle's own motion allow.
    """
    if shift_m is None:
        return so_far_m
    total_m = shift_m if so_far_m is None else so_far_m + shift_m
    return total_m if np.linalg.norm(total_m) > 0.5 * np.linalg.norm(shift_m) else None


def position_shift(innovations: Innovations) -> tuple[Vector, Vector]:
    """The shift of position (3,) that the ranges share, their clocks unknown, and its covariance
    (3, 3)."""
    h, v, clocks = innovations.geometry[:, :3], innovations.range_m, innovations.geometry[:, CLOCK:]
    return _eliminate_clocks(h, clocks[:, clocks.any(axis=0)], v, innovations.variance)


def velocity_shift(innovations: Innovations) -> tuple[Vector, Vector]:
    """The shift of velocity (3,) that the known rates share, the drift unknown, and its covariance
    (3, 3)."""
    known = np.isfinite(innovations.rate_mps)
    h, v = innovations.geometry[known, :3], innovations.rate_mps[known]
    return _eliminate_clocks(h, np.ones((len(v), 1)), v, innovations.rate_variance[known])


def _eliminate_clocks(
    h: Vector, clocks: Vector, v: Vector, variance: Vector
) -> tuple[Vector, Vector]:
    """A vector (3,) and its covariance (3, 3) by innovations v (n,) whose clocks are unknown."""
    columns = np.hstack([h, clocks]) / np.sqrt(variance)[:, None]
    # Pseudo-inverse: satellites in one direction leave an axis without information.
    cofactor: Vector = np.asarray(np.linalg.pinv(columns.T @ columns, hermitian=True), np.float64)
    return (cofactor @ columns.T @ (v / np.sqrt(variance)))[:3], cofactor[:3, :3]
