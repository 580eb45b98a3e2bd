"""Estimates the latency of a receiver's fixes, which real receivers do not report: 0.1 to 0.5 s.

While the vehicle accelerates an outdated velocity contradicts a healthy IMU (docs/fdi.md, "Latency
of a fix"). A simulator's HIL_GPS has the stamp of its measurement.
"""

from typing import NamedTuple

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.receiver.position_test import FixMeasurement, FixTest
from analysis.samples.sample import Vector

USUAL_S, SIGMA_S = 0.15, 0.15  # prior of a real receiver, for the 0.1 to 0.5 s above
LEAST_S, MOST_S = 0.0, 0.6  # the 0.1 to 0.5 s above, and 0.1 s for the link
LEAST_VARIANCE = 0.05**2  # for the test: without it a vibrating ArduCopter's IMU is isolated
# A smaller variance for learning, so that errors that last for seconds do not move the mean.
LEAST_LEARNED_VARIANCE = 0.01**2
EXACT_SOURCE = "HIL_GPS"


class Latency(NamedTuple):
    """Seconds and their variance; `past` are the durations of the newest intervals between fixes
    and the mean accelerations (3,) in them, newest first."""

    seconds: float = 0.0
    variance: float = 0.0
    past: tuple[tuple[float, Vector], ...] = ()

    @property
    def sigma_s(self) -> float:
        """Standard deviation of the latency for a test [s]."""
        return float(np.sqrt(max(self.variance, LEAST_VARIANCE)))

    def velocity_change(self, seconds: float) -> Vector:
        """The change of the velocity (3,) in the last `seconds`."""
        change = np.zeros(3)
        for at, (duration_s, acceleration) in enumerate(self.past):
            # Before the first interval the first acceleration is assumed.
            span_s = seconds if at == len(self.past) - 1 else min(seconds, duration_s)
            change += span_s * acceleration
            seconds -= span_s
        return change

    def slope(self) -> Vector:
        """The derivative of the reported velocity by the latency: the acceleration (3,) then."""
        sigma_s = self.sigma_s
        first, last = max(self.seconds - sigma_s, 0.0), self.seconds + sigma_s
        return np.asarray(
            (self.velocity_change(last) - self.velocity_change(first)) / (last - first)
        )


def initial_latency(source: str) -> Latency:
    """The prior for a receiver, by its message."""
    return Latency() if source == EXACT_SOURCE else Latency(USUAL_S, SIGMA_S**2)


def mean_acceleration(before: MotionEstimate, predicted: MotionEstimate, axes: Vector) -> Vector:
    """The mean acceleration (3,) in m/s^2 along `axes` since the last fix; zero without an IMU."""
    if not (before.inertial and predicted.inertial):
        return np.zeros(3)
    dt_s = (predicted.t_us - before.t_us) * 1e-6
    return np.asarray(axes @ (predicted.x[3:6] - before.x[3:6]) / dt_s)


def append_interval(latency: Latency, dt_s: float, acceleration_mps2: Vector) -> Latency:
    """The latency after an interval of `dt_s` with an acceleration (3,)."""
    if latency.variance == 0.0:
        return latency
    intervals, total_s = [(dt_s, acceleration_mps2)], dt_s
    for interval in latency.past:
        if total_s >= MOST_S + SIGMA_S:
            break
        intervals.append(interval)
        total_s += interval[0]
    return latency._replace(past=tuple(intervals))


def compensate_latency(
    fix: FixMeasurement, predicted: MotionEstimate, latency: Latency
) -> FixMeasurement:
    """The fix moved to the present, with the uncertainty of the latency."""
    if latency.variance == 0.0 or not predicted.inertial:
        return fix
    velocity, variance = fix.axes @ predicted.x[3:6], latency.sigma_s**2
    gained = latency.velocity_change(latency.seconds)
    moved = latency.seconds * (predicted.x[3:6] - fix.axes.T @ gained / 2.0)
    fix = fix._replace(
        r_ecef_m=fix.r_ecef_m + moved, variance_m2=fix.variance_m2 + variance * velocity**2
    )
    if fix.v_ned_mps is None:
        return fix
    return fix._replace(
        v_ned_mps=fix.v_ned_mps + gained,
        v_variance=fix.v_variance + variance * latency.slope() ** 2,
    )


def update_latency(latency: Latency, velocity: FixTest, p: Vector) -> Latency:
    """The latency after a velocity that passed; p (n, n) is the filter's covariance before it."""
    if latency.variance == 0.0 or len(velocity.v) < 3:
        return latency
    seconds, variance, _ = latency
    # The test's variance already contains the latency's part.
    spread = np.diag(velocity.h @ p @ velocity.h.T) + velocity.variance
    for v, a, total in zip(velocity.v, latency.slope(), spread, strict=True):
        gain = variance * a / max(total, variance * a * a)
        seconds -= gain * v  # the innovation is the latency's error times the acceleration
        variance -= gain * a * variance
    seconds = float(np.clip(seconds, LEAST_S, MOST_S))
    return latency._replace(seconds=seconds, variance=max(variance, LEAST_LEARNED_VARIANCE))
