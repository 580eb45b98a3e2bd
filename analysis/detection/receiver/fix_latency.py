"""How late a receiver's fixes are, which real receivers do not tell: 0.1 to 0.5 s.

A fix is stamped when its message came, or was logged. While the vehicle accelerates the velocity it
tells is one that has passed, and a sound receiver contradicts a sound IMU. The latency hardly
changes in a flight, so it is a state of one number: learnt from the velocities while the vehicle
accelerates, and as unsure as it is it widens the test. A simulator's HIL_GPS is stamped when it was
measured.
"""

from typing import NamedTuple

import numpy as np

from analysis.detection.filter.filter_state import Motion
from analysis.detection.receiver.position_test import Check, Measured
from analysis.samples.sample import Vector

USUAL_S, SIGMA_S = 0.15, 0.15
LEAST_S, MOST_S = 0.0, 0.6
LEAST_VARIANCE = 0.05**2  # it is never known better: what accelerates changes meanwhile
EXACT_SOURCE = "HIL_GPS"


class Latency(NamedTuple):
    """Seconds and their variance."""

    seconds: float = 0.0
    variance: float = 0.0


def latency_of(source: str) -> Latency:
    """What is known of a receiver by its message alone."""
    return Latency() if source == EXACT_SOURCE else Latency(USUAL_S, SIGMA_S**2)


def accelerated(before: Motion, predicted: Motion, axes: Vector) -> Vector:
    """The mean acceleration (3,) in m/s^2 along `axes` since the last fix; zero without an IMU."""
    if not (before.inertial and predicted.inertial):
        return np.zeros(3)
    dt_s = (predicted.t_us - before.t_us) * 1e-6
    acceleration: Vector = axes @ (predicted.x[3:6] - before.x[3:6]) / dt_s
    return acceleration


def on_time(
    measured: Measured, predicted: Motion, acceleration_mps2: Vector, latency: Latency
) -> Measured:
    """The fix where the vehicle is by now, as unsure as its latency is."""
    if latency.variance == 0.0 or not predicted.inertial:
        return measured
    velocity = measured.axes @ predicted.x[3:6]
    r_ecef_m = measured.r_ecef_m + latency.seconds * predicted.x[3:6]
    measured = measured._replace(
        r_ecef_m=r_ecef_m, variance_m2=measured.variance_m2 + latency.variance * velocity**2
    )
    if measured.v_ned_mps is None:
        return measured
    return measured._replace(
        v_ned_mps=measured.v_ned_mps + latency.seconds * acceleration_mps2,
        v_variance=measured.v_variance + latency.variance * acceleration_mps2**2,
    )


def learnt(latency: Latency, velocity: Check, acceleration_mps2: Vector, p: Vector) -> Latency:
    """The latency after a velocity that passed; p (n, n) is the filter's covariance before it."""
    if latency.variance == 0.0 or len(velocity.v) < len(acceleration_mps2):
        return latency
    seconds, variance = latency
    # The test's variance has the latency's own part in it already.
    spread = np.diag(velocity.h @ p @ velocity.h.T) + velocity.variance
    for v, a, whole in zip(velocity.v, acceleration_mps2, spread, strict=True):
        gain = variance * a / max(whole, variance * a * a)
        seconds -= gain * v  # the innovation is how much too long it is, times the acceleration
        variance -= gain * a * variance
    return Latency(float(np.clip(seconds, LEAST_S, MOST_S)), max(variance, LEAST_VARIANCE))
