"""The filter from one epoch to the next: by the IMU where it is usable, freely otherwise.

The filter's position and velocity are the antenna's at every epoch; in between the IMU propagates
it at its own position (docs/fdi.md, "Filter"; Groves, Principles of GNSS, Inertial and Multisensor
Integrated Navigation, 2nd ed., 14.3.1).
"""

from typing import NamedTuple

import numpy as np

from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import (
    BG,
    ERROR_SIZE,
    PSI,
    X_BG,
    X_Q,
    R,
    V,
    propagate_freely,
    propagate_inertial,
)
from analysis.detection.values import Value
from analysis.samples.block import ImuRun
from analysis.samples.sample import IMU_VALUE_LIMIT, Vector
from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

PENDING_MAX = 40_000  # samples between two epochs, 200 s at 200 Hz; older ones are dropped
NO_RUN = ImuRun(np.empty(0, np.int64), np.empty((0, 6)))
RATE_SIGMA_RPS = 0.5  # one sigma of a vehicle's rate while its IMU is silent: 30 degrees/s
SHORT_GAP_S = 1.0  # after a longer one the attitude is searched for again
SILENT_INTERVALS = 5.0  # usual intervals that a gap must exceed to be the IMU's fault
INTERVAL_GAIN = 0.05  # of the usual interval's filter: a memory of 20 epochs


class ImuSegment(NamedTuple):
    """The IMU between two epochs: samples (k, 7), each with the length of its step; `gap_s` is the
    longest silence, `any_sample` whether there was any sample."""

    samples: Vector
    gap_s: float
    any_sample: bool


def add_pending(run: ImuRun, pending: ImuRun) -> ImuRun:
    """The samples that wait for an epoch with one run more; only the newest are kept."""
    if not len(run.t_us):
        return pending
    t_us, values = (np.concatenate(both)[-PENDING_MAX:] for both in zip(pending, run, strict=True))
    return ImuRun(t_us, values)


def split_pending(pending: ImuRun, until_us: int) -> tuple[ImuRun, ImuRun]:
    """Samples up to `until_us`, each later than all before it, and those that stay pending."""
    t_us, values = pending
    if (t_us[1:] <= t_us[:-1]).any():
        # Stamps that go back are dropped: sorting would mix two clocks.
        later = np.append(True, t_us[1:] > np.maximum.accumulate(t_us)[:-1])
        t_us, values = t_us[later], values[later]
    # `right`: a sample at the epoch's own stamp belongs to the time before it.
    at = int(t_us.searchsorted(until_us, side="right"))
    return ImuRun(t_us[:at], values[:at]), ImuRun(t_us[at:], values[at:])


def update_interval_s(known_s: float, run: ImuRun) -> float:
    """The time between two samples of the IMU, of which `run` are the newest; 0 while unknown."""
    count = len(run.t_us)
    if count < 2:
        return known_s
    interval_s = int(run.t_us[-1] - run.t_us[0]) * 1e-6 / (count - 1)
    return known_s + (INTERVAL_GAIN if known_s > 0.0 else 1.0) * (interval_s - known_s)


def is_silent(gap_s: float, usual_s: float, config: FilterConfig) -> bool:
    """Whether a gap is the IMU's fault: too long for the filter, and for this IMU."""
    return gap_s > max(config.gap_s, SILENT_INTERVALS * usual_s)


def imu_segment(run: ImuRun, motion: MotionEstimate, until_us: int) -> ImuSegment:
    """The steps from the filter's time to `until_us`; the last sample extends to the end. Without
    samples if one of them is implausible."""
    # Samples before the filter's time have been used already.
    at = run.t_us.searchsorted(motion.t_us, side="right")
    t_us, values = run.t_us[at:], run.values[at:]
    if not len(t_us):
        return ImuSegment(np.empty((0, 7)), (until_us - motion.t_us) * 1e-6, False)
    steps_s = np.diff(t_us, prepend=motion.t_us, append=until_us) * 1e-6
    if not (np.abs(values) <= IMU_VALUE_LIMIT).all():  # which NaN is not
        return ImuSegment(np.empty((0, 7)), float(steps_s.sum()), True)
    table = np.column_stack((steps_s, np.concatenate((values, values[-1:]))))
    return ImuSegment(table, float(steps_s.max()), True)


class Prediction(Value, frozen=True):
    """The filter `before`, at the last epoch, and `motion`, at this one before it is used; the
    transition (20, 20) of its errors in between, and the IMU's samples."""

    before: MotionEstimate
    motion: MotionEstimate
    transition: Vector
    segment: ImuSegment

    @property
    def dt_s(self) -> float:
        """The time between the epochs."""
        return (self.motion.t_us - self.before.t_us) * 1e-6

    @property
    def is_inertial(self) -> bool:
        """Whether the IMU propagated the filter all the way."""
        return self.before.inertial and self.motion.inertial


def predict(motion: MotionEstimate, run: ImuRun, until_us: int, config: FilterConfig) -> Prediction:
    """The filter `motion` at `until_us` by the IMU's samples `run` since its epoch: by the IMU
    where it is usable."""
    segment, noise = imu_segment(run, motion, until_us), config.noise
    dt_s = (until_us - motion.t_us) * 1e-6
    complete = segment.gap_s <= config.gap_s and len(segment.samples) > 0
    if motion.inertial and complete:
        samples, arm, x, p = segment.samples, config.antenna, motion.x, motion.p
        if arm is None:
            x, p, phi = propagate_inertial(x, p, samples, noise)
        else:  # the filter's position is the antenna's, the IMU measures at its own: there and back
            x, p, back = shift_by_lever_arm(x, p, samples[0, 1:4], arm, -1.0)
            x, p, phi = propagate_inertial(x, p, samples, noise)
            x, p, out = shift_by_lever_arm(x, p, samples[-1, 1:4], arm, 1.0)
            phi = out @ phi @ back
        return Prediction(motion, MotionEstimate(until_us, x, p, True), phi, segment)
    x, p, phi = propagate_freely(motion.x, motion.p, dt_s, noise)
    # Over a short silence the attitude is still known, but less well.
    inertial = motion.inertial and segment.gap_s <= SHORT_GAP_S and segment.any_sample
    if inertial:
        p[range(PSI, PSI + 3), range(PSI, PSI + 3)] += (RATE_SIGMA_RPS * segment.gap_s) ** 2
    # A gap breaks the integrals of an alignment.
    alignment = motion.alignment if complete and not motion.inertial else None
    moved = MotionEstimate(until_us, x, p, inertial, alignment)
    return Prediction(motion, moved, phi, segment)


def shift_by_lever_arm(
    x: Vector, p: Vector, gyro_b_rps: Vector, arm_b_m: Vector, sign: float
) -> tuple[Vector, Vector, Vector]:
    """State and covariance at the antenna (sign 1) of those at the IMU, or back (-1).

    Parameters
    ----------
    x, p : (21,) and (20, 20)
    gyro_b_rps, arm_b_m : (3,), the gyro's reading and the arm from IMU to antenna

    Returns
    -------
    x, p and the matrix (20, 20) that turns the errors of the one into those of the other.
    """
    c = rotation_matrix(x[X_Q : X_Q + 4])
    # The Earth's rotation seen in body axes is the last row of C times its rate.
    turning = gyro_b_rps - x[X_BG : X_BG + 3] - GNSS_EARTH_RATE_RPS * c[2]
    arm, speed = c @ arm_b_m, c @ np.cross(turning, arm_b_m)
    jacobian = np.eye(ERROR_SIZE)
    jacobian[R : R + 3, PSI : PSI + 3] = -sign * cross_matrix(arm)
    jacobian[V : V + 3, PSI : PSI + 3] = -sign * cross_matrix(speed)
    jacobian[V : V + 3, BG : BG + 3] = sign * c @ cross_matrix(arm_b_m)
    x = x.copy()
    x[R : R + 3] += sign * arm
    x[V : V + 3] += sign * speed
    return x, jacobian @ p @ jacobian.T, jacobian


def cross_matrix(v: Vector) -> Vector:
    """[v]x (3, 3)."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
