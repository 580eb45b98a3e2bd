"""Without raw ranges: who is wrong when a receiver's velocity and the IMU contradict each other.

A spoofer moves position and velocity together, so a receiver that agrees with itself may still lie,
and two sources alone cannot vote. Two things tell more:

- What is wrong with the IMU stands in its own output. If the change of its specific force since
  the last fix is just what the velocities differ by, it is the IMU.
- A wrong attitude turns the specific force f, which errs by 2 |f| at most. If the difference of the
  velocities grew faster while the IMU showed no such change, it is the receiver.

Whatever neither explains is the receiver or the IMU, and that is the verdict.
"""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector_state import LastFix
from analysis.detection.filter.filter_state import Motion
from analysis.detection.filter.propagation import Segment
from analysis.detection.isolation.chi_square import chi_square
from analysis.detection.sensors.position_test import VELOCITY_SIGMA_MPS, Check, Measured
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.rotation_kernel import matrix

EITHER = "GPS-or-imu"
EXCUSED_SIGMAS = 4.0  # of the velocity's noise, that a growth may exceed what an IMU can do
FORCE = slice(4, 7)  # of a row of the IMU's segment: specific force, behind its time and rates


def last_fix(t_us: int, measured: Measured, part: Segment | None, motion: Motion) -> LastFix:
    """The fix as the next one needs it; `motion` is the filter after it."""
    off = np.zeros(3)
    if measured.v_ned_mps is not None:
        off = np.nan_to_num(measured.v_ned_mps - measured.axes @ motion.x[3:6])
    return LastFix(t_us, measured.r_ecef_m, None if part is None else mean_force(part), off)


def mean_force(part: Segment) -> Vector | None:
    """Mean specific force (3,) of an interval in body axes; None without samples."""
    rows = part.samples
    total_s = rows[:, 0].sum() if len(rows) else 0.0
    return rows[:, 0] @ rows[:, FORCE] / total_s if total_s > 0.0 else None


def culprit(
    last: LastFix | None,
    measured: Measured,
    predicted: Motion,
    velocity: Check,
    part: Segment,
    config: DetectorConfig,
) -> str:
    """`imu`, `gps` or `GPS-or-imu`, for a receiver that agrees with itself but not with the IMU.

    `velocity` is the failed test, `part` the IMU since the last fix, `predicted` the filter moved
    by it.
    """
    force = mean_force(part)
    if last is None or force is None or last.force_b_mps2 is None or measured.v_ned_mps is None:
        return EITHER
    known = np.isfinite(measured.v_ned_mps)
    dt_s = (predicted.t_us - last.t_us) * 1e-6
    rot = measured.axes @ matrix(predicted.x[6:10])
    changed_mps = (rot @ (force - last.force_b_mps2) * dt_s)[known]
    sigma_mps = np.array([VELOCITY_SIGMA_MPS[0], *VELOCITY_SIGMA_MPS])[known]
    remaining = (velocity.v + changed_mps) / sigma_mps
    if float(remaining @ remaining) <= chi_square(len(remaining), config.p_other):
        return "imu"
    grown_mps = float(np.linalg.norm(velocity.v - last.off_mps[known]))
    most_mps2 = 2.0 * max(np.linalg.norm(force), np.linalg.norm(last.force_b_mps2))
    excused_mps = most_mps2 * dt_s + EXCUSED_SIGMAS * VELOCITY_SIGMA_MPS[0]
    return "gps" if grown_mps > excused_mps else EITHER
