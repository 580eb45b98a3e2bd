"""Factors between consecutive epochs: the preintegrated IMU, or a motion model without it.

Preintegration is that of Forster et al. [1]_ with correlated biases, in a frame that rotates with
the earth (Coriolis term; the centrifugal part is in gravity). The motion model is the same factor
with synthetic input: no gravity, force or rotation, and noise as large as the motion may be, so
that position and velocity stay consistent.

References
----------
.. [1] C. Forster et al., IEEE Trans. Robotics 33(1), 2017.
"""

from typing import Any

import gtsam
import numpy as np

from analysis.detection.filter.process_noise import ProcessNoise
from analysis.fusion.local_frame import LocalFrame
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

INTEGRATION_SIGMA_M = 1e-3  # m/sqrt(s), noise of the integration; small against range sigmas
MAX_STEP_S = 0.1  # faster samples are condensed to it; the neglected terms are of third order
MODEL_STEP_S = 0.05  # of the motion model's synthetic samples
# Share of the detector's motion noise: Doppler rates fix the velocity at both ends, and between
# them it changes more smoothly than white noise of that size would.
MOTION_NOISE_SHARE = 0.25
FREE_RATE_RPS = 30.0  # larger than any vehicle's rate: leaves the attitude free


def imu_params(frame: LocalFrame, r_m: Vector, noise: ProcessNoise) -> Any:
    """Preintegration parameters at a position (3,) of the local frame in m."""
    return _params(frame.gravity(r_m), frame, noise, noise.gyro_rps, noise.accel_mps2)


def preintegrate_imu(samples: Vector, bias: Any, params: Any) -> Any:
    """Preintegrate samples (k, 7) of `propagation.segment`: step in s, rates, specific force."""
    preintegrated = gtsam.PreintegratedCombinedMeasurements(params, bias)
    for row in condense_samples(samples, MAX_STEP_S):
        preintegrated.integrateMeasurement(row[4:7], row[1:4], row[0])
    return preintegrated


@compiled
def condense_samples(samples: Vector, step_s: float) -> Vector:
    """Combine samples (k, 7) into groups of equal number up to `step_s` long; drop empty steps.

    A group's rate is its rotation vector over its duration, its force is in the axes at its start:
    GTSAM takes both as constant. Rotation within a group is added to second order (coning,
    sculling).
    """
    count, total_s = 0, 0.0
    for k in range(samples.shape[0]):
        if samples[k, 0] > 0.0:
            count, total_s = count + 1, total_s + samples[k, 0]
    # The 0.1 keeps rounding from making every group one sample too short.
    size = max(int(step_s * count / total_s + 0.1), 1) if count else 1
    out = np.zeros(((count + size - 1) // size, 7))
    rotvec, half, force = np.zeros(3), np.zeros(3), np.zeros(3)
    once, twice, bent = np.zeros(3), np.zeros(3), np.zeros(3)
    at = 0
    for k in range(samples.shape[0]):
        dt = samples[k, 0]
        if not dt > 0.0:
            continue
        row = out[at // size]
        if at % size == 0:
            rotvec[:] = 0.0
        for i in range(3):
            half[i] = rotvec[i] + 0.5 * dt * samples[k, 1 + i]
            force[i] = samples[k, 4 + i]
        _cross(half, force, once)
        _cross(half, once, twice)
        _cross(rotvec, samples[k, 1:4], bent)
        row[0] += dt
        for i in range(3):
            row[4 + i] += dt * (force[i] + once[i] + 0.5 * twice[i])
            rotvec[i] += dt * (samples[k, 1 + i] + 0.5 * bent[i])
            row[1 + i] = rotvec[i]
        at += 1
    for k in range(out.shape[0]):
        for i in range(1, 7):
            out[k, i] /= out[k, 0]
    return out


@compiled
def _cross(a: Vector, b: Vector, out: Vector) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


def motion_model(
    dt_s: float, bias: Any, frame: LocalFrame, noise: ProcessNoise, rate_sigma_rps: float
) -> Any:
    """The motion model over `dt_s`, for a body whose rates have the sigma `rate_sigma_rps`."""
    params = _params(
        np.zeros(3), frame, noise, rate_sigma_rps, MOTION_NOISE_SHARE * noise.motion_mps2
    )
    preintegrated = gtsam.PreintegratedCombinedMeasurements(params, bias)
    steps = max(round(dt_s / MODEL_STEP_S), 2)
    for _ in range(steps):
        # The biases as measured values: GTSAM subtracts them, and no force or rotation remains.
        preintegrated.integrateMeasurement(bias.accelerometer(), bias.gyroscope(), dt_s / steps)
    return preintegrated


def _params(
    gravity: Vector, frame: LocalFrame, noise: ProcessNoise, gyro: float, accel: float
) -> Any:
    params = gtsam.PreintegrationCombinedParams(gravity)
    unit = np.eye(3)
    params.setGyroscopeCovariance(unit * gyro**2)
    params.setAccelerometerCovariance(unit * accel**2)
    params.setIntegrationCovariance(unit * INTEGRATION_SIGMA_M**2)
    params.setBiasOmegaCovariance(unit * noise.gyro_walk**2)
    params.setBiasAccCovariance(unit * noise.accel_walk**2)
    params.setOmegaCoriolis(frame.earth_rate())
    return params
