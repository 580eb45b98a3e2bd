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

from analysis.detection.filter.filter_config import ProcessNoise
from analysis.fusion.local_frame import LocalFrame
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS

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


def condense_samples(samples: Vector, step_s: float) -> Vector:
    """Combine samples (k, 7) into groups of equal number up to `step_s` long; drop empty steps.

    A group's rate is its rotation vector over its duration, its force is in the axes at its start:
    GTSAM takes both as constant. Rotation within a group is added to second order (coning,
    sculling).
    """
    samples = samples[samples[:, 0] > 0.0]
    count, total_s = len(samples), samples[:, 0].sum()
    # The 0.1 keeps rounding from making every group one sample too short.
    size = max(int(step_s * count / total_s + 0.1), 1) if count else 1
    # The last group is filled with empty steps; all groups are integrated together.
    filled = np.zeros((-(-count // size), size, 7))
    filled.reshape(-1, 7)[:count] = samples
    dt, force = filled[..., :1], filled[..., 4:]
    turns = dt * filled[..., 1:4]
    before = turns.cumsum(axis=1) - turns  # the rotation since the group's start, to first order
    bent = 0.5 * np.cross(before, turns)
    before += bent.cumsum(axis=1) - bent
    rotvec = (turns + 0.5 * np.cross(before, turns)).sum(axis=1)
    turned = np.cross(before + 0.5 * turns, force)
    twice = np.cross(before + 0.5 * turns, turned)
    velocity = (dt * (force + turned + 0.5 * twice)).sum(axis=1)
    return np.hstack([(whole := dt.sum(axis=1)), rotvec / whole, velocity / whole])


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
    # The Earth rotates about z of ECEF: the third column is that axis in the frame.
    params.setOmegaCoriolis(frame.axes[:, 2] * GNSS_EARTH_RATE_RPS)
    return params
