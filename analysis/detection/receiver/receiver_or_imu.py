"""Without raw ranges: who is wrong when a receiver's velocity and the IMU contradict each other.

A spoofer moves position and velocity together, so a receiver that agrees with itself may still lie,
and two sources alone cannot vote. Two things tell more:

- What is wrong with the IMU stands in its own output. If its specific force changed within the last
  three intervals, and the velocities differ by what that makes in the time since, it is the IMU.
- A wrong attitude turns the specific force f. One that is 60 degrees wrong errs by |f|; gyros would
  have to be 3 rad/s off to get there before they are found. If the difference of the velocities
  grew faster than that while the IMU showed no such change, it is the receiver.

Whatever neither explains is the receiver or the IMU, and that is the verdict.
"""

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.propagation import ImuSegment
from analysis.detection.receiver.position_test import (
    VELOCITY_SIGMA_MPS,
    FixMeasurement,
    FixTest,
    known_or_zero,
)
from analysis.detection.receiver.receiver_state import LastFix
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.statistics.false_alarm_rates import FalseAlarmRates
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

UNDECIDED = "GPS-or-imu"
EXCUSED_SIGMAS = 4.0  # of the velocity's noise, that a growth may exceed what an IMU can do
ALIKE_SHARE = 0.4  # share by which a change of the IMU's force may differ from a wrong acceleration
# In which a fault of the IMU may have begun before a fix shows it, or several together
INTERVALS, HISTORY_INTERVALS = 3, 6
FORCE = slice(4, 7)  # of a row of the IMU's segment: specific force, behind its time and rates


def new_last_fix(
    before: LastFix | None, measured: FixMeasurement, part: ImuSegment, motion: MotionEstimate
) -> LastFix:
    """The fix as the next one needs it; `motion` is the filter after it."""
    velocity = np.full(3, np.nan) if measured.v_ned_mps is None else measured.v_ned_mps
    off = known_or_zero(velocity - measured.axes @ motion.x[3:6])
    force = mean_force(part)
    past = () if before is None else before.forces_b_mps2[: HISTORY_INTERVALS - 1]
    forces = () if force is None else (force, *past)
    return LastFix(motion.t_us, measured.r_ecef_m, velocity, forces, off)


def mean_force(part: ImuSegment) -> Vector | None:
    """Mean specific force (3,) of an interval in body axes; None without samples."""
    rows = part.samples
    total_s = rows[:, 0].sum() if len(rows) else 0.0
    return rows[:, 0] @ rows[:, FORCE] / total_s if total_s > 0.0 else None


def unexplained_square(
    v_mps: Vector, sigma_mps: Vector, changed_mps: Vector, intervals: int
) -> float:
    """What a force that changed by what makes `changed_mps` (n,) of velocity an interval, within
    some intervals, leaves of a difference of velocities (n,): squared over its sigma (n,)."""
    size = float(changed_mps @ changed_mps)
    # A fault that began in these intervals has acted for none to all of their time.
    times = min(max(-float(v_mps @ changed_mps) / size, 0.0), intervals) if size > 0.0 else 0.0
    remaining = (v_mps + times * changed_mps) / sigma_mps
    return float(remaining @ remaining)


def isolate_receiver_or_imu(
    last: LastFix | None,
    measured: FixMeasurement,
    predicted: MotionEstimate,
    velocity: FixTest,
    part: ImuSegment,
    config: FalseAlarmRates,
) -> str:
    """`imu`, `gps` or `GPS-or-imu`, for a receiver that agrees with itself but not with the IMU.

    `velocity` is the failed test, `part` the IMU since the last fix, `predicted` the filter moved
    by it.
    """
    force = mean_force(part)
    if last is None or force is None or not last.forces_b_mps2 or measured.v_ned_mps is None:
        return UNDECIDED
    known = np.isfinite(measured.v_ned_mps)
    dt_s = (predicted.t_us - last.t_us) * 1e-6
    rot = measured.axes @ rotation_matrix(predicted.x[6:10])
    sigma_mps = np.array([VELOCITY_SIGMA_MPS[0], *VELOCITY_SIGMA_MPS])[known]
    for since, before in enumerate(last.forces_b_mps2[:INTERVALS], start=1):
        changed_mps = (rot @ (force - before) * dt_s)[known]
        remaining = unexplained_square(velocity.v, sigma_mps, changed_mps, since)
        if remaining <= chi_square_threshold(len(sigma_mps), config.p_other):
            return "imu"
    grown_mps = float(np.linalg.norm(velocity.v - last.off_mps[known]))
    most_mps2 = max(np.linalg.norm(force), np.linalg.norm(last.forces_b_mps2[0]))
    excused_mps = float(most_mps2) * dt_s + EXCUSED_SIGMAS * VELOCITY_SIGMA_MPS[0]
    return "gps" if grown_mps > excused_mps else UNDECIDED


def isolate_acceleration_fault(
    last: LastFix | None,
    wrong_mps2: Vector,
    measured: FixMeasurement,
    predicted: MotionEstimate,
    part: ImuSegment,
) -> str:
    """`imu` or `GPS-or-imu`, for a filter that is accelerated wrongly (3,), against a receiver that
    agrees with itself: the IMU, if its force changed by that within the last intervals."""
    force = mean_force(part)
    if last is None or force is None:
        return UNDECIDED
    rot = measured.axes @ rotation_matrix(predicted.x[6:10])
    most_mps2 = ALIKE_SHARE * float(np.linalg.norm(wrong_mps2))
    changes = [rot @ (force - before) for before in last.forces_b_mps2]
    alike = [float(np.linalg.norm(change - wrong_mps2)) <= most_mps2 for change in changes]
    return "imu" if any(alike) else UNDECIDED
