"""Isolates the fault when a receiver's velocity and the IMU disagree, without raw ranges.

A spoofer moves position and velocity together, so a receiver that is consistent with itself may
still be faulty, and two sources cannot vote. The criteria are those of docs/fdi.md, "Without raw
ranges".
"""

import numpy as np

from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.propagation import ImuSegment
from analysis.detection.receiver.position_test import (
    VELOCITY_SIGMA_MPS,
    AssessedFix,
    known_or_zero,
)
from analysis.detection.receiver.receiver_state import LastFix
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

UNDECIDED = "GPS-or-imu"
EXCUSED_SIGMAS = 4.0  # of the velocity, beyond the growth that an IMU fault can cause: p 6e-5
ALIKE_SHARE = 0.4  # a change of force and a wrong acceleration differ by less: 24 degrees, or 40 %
# Intervals in which an IMU fault may have begun before one fix shows it, or the windows do
INTERVALS, HISTORY_INTERVALS = 3, 6
FORCE = slice(4, 7)  # columns of the specific force in the IMU's segment, after time and rates


def new_last_fix(before: LastFix | None, fix: AssessedFix, motion: MotionEstimate) -> LastFix:
    """The data of the fix that the next one needs; `motion` is the filter after it."""
    measurement = fix.measurement
    velocity = np.full(3, np.nan) if measurement.v_ned_mps is None else measurement.v_ned_mps
    off = known_or_zero(velocity - measurement.axes @ motion.x[3:6])
    force = mean_force(fix.prediction.segment)
    past = () if before is None else before.forces_b_mps2[: HISTORY_INTERVALS - 1]
    forces = () if force is None else (force, *past)
    return LastFix(motion.t_us, measurement.r_ecef_m, velocity, forces, off)


def mean_force(segment: ImuSegment) -> Vector | None:
    """Mean specific force (3,) of an interval in body axes; None without samples."""
    rows = segment.samples
    total_s = rows[:, 0].sum() if len(rows) else 0.0
    return rows[:, 0] @ rows[:, FORCE] / total_s if total_s > 0.0 else None


def unexplained_square(
    v_mps: Vector, sigma_mps: Vector, changed_mps: Vector, intervals: int
) -> float:
    """The squared remainder, over its sigma (n,), of a velocity difference (n,) after the best fit
    of a force that changed within some intervals, by `changed_mps` (n,) per interval."""
    size = float(changed_mps @ changed_mps)
    # A fault that began in these intervals has acted for 0 to all of their time.
    times = min(max(-float(v_mps @ changed_mps) / size, 0.0), intervals) if size > 0.0 else 0.0
    remaining = (v_mps + times * changed_mps) / sigma_mps
    return float(remaining @ remaining)


def isolate_receiver_or_imu(last: LastFix | None, fix: AssessedFix, config: FilterConfig) -> str:
    """`imu`, `gps` or `GPS-or-imu`, for a receiver that is consistent, but not with the IMU: the
    test of its velocity has failed."""
    force, measurement, velocity = mean_force(fix.prediction.segment), fix.measurement, fix.velocity
    if last is None or force is None or not last.forces_b_mps2:
        return UNDECIDED
    if measurement.v_ned_mps is None or velocity is None:
        return UNDECIDED
    known = np.isfinite(measurement.v_ned_mps)
    dt_s = (fix.motion.t_us - last.t_us) * 1e-6
    rot = measurement.axes @ rotation_matrix(fix.motion.x[6:10])
    sigma_mps = np.array([VELOCITY_SIGMA_MPS[0], *VELOCITY_SIGMA_MPS])[known]
    for since, before in enumerate(last.forces_b_mps2[:INTERVALS], start=1):
        changed_mps = (rot @ (force - before) * dt_s)[known]
        remaining = unexplained_square(velocity.v, sigma_mps, changed_mps, since)
        if remaining <= chi_square_threshold(len(sigma_mps), config.p_other):
            return "imu"
    grown_mps = float(np.linalg.norm(velocity.v - last.off_mps[known]))
    limit_mps2 = max(np.linalg.norm(force), np.linalg.norm(last.forces_b_mps2[0]))
    excused_mps = float(limit_mps2) * dt_s + EXCUSED_SIGMAS * VELOCITY_SIGMA_MPS[0]
    return "gps" if grown_mps > excused_mps else UNDECIDED


def isolate_acceleration_fault(last: LastFix | None, wrong_mps2: Vector, fix: AssessedFix) -> str:
    """`imu` or `GPS-or-imu`, for a wrong acceleration (3,) of the filter and a receiver that is
    consistent with itself: the IMU, if its force changed by that within the last intervals."""
    force = mean_force(fix.prediction.segment)
    if last is None or force is None:
        return UNDECIDED
    rot = fix.measurement.axes @ rotation_matrix(fix.motion.x[6:10])
    limit_mps2 = ALIKE_SHARE * float(np.linalg.norm(wrong_mps2))
    changes = [rot @ (force - before) for before in last.forces_b_mps2]
    similar = [float(np.linalg.norm(change - wrong_mps2)) <= limit_mps2 for change in changes]
    return "imu" if any(similar) else UNDECIDED
