"""What ties one epoch to the next: the IMU preintegrated, or a model of motion without it.

Preintegration is that of Forster et al. [1]_ with correlated biases, in a frame that turns with the
earth (Coriolis term; the centrifugal part is in gravity). The motion model is the same factor fed
with fiction: no gravity, no measured force and no turn, and noise as large as the motion may be,
so that position and velocity stay tied to each other.

References
----------
.. [1] C. Forster et al., IEEE Trans. Robotics 33(1), 2017.
"""

from typing import Any

import gtsam
import numpy as np

from analysis.fdi.config import Noise
from analysis.fdi.motion import TURN_SIGMA_RPS
from analysis.fusion.frame import Frame
from analysis.samples import Vector

INTEGRATION_M = 1e-3  # m/sqrt(s), position noise of the integration itself
FICTION_STEP_S = 0.05


def preintegrate(samples: Vector, bias: Any, frame: Frame, r_m: Vector, noise: Noise) -> Any:
    """The IMU's samples (k, 7) of `fdi.motion.segment`: step in s, rates, specific force."""
    params = _params(frame.gravity(r_m), frame, noise, noise.gyro_rps, noise.accel_mps2)
    preintegrated = gtsam.PreintegratedCombinedMeasurements(params, bias)
    for row in samples:
        if row[0] > 0.0:
            preintegrated.integrateMeasurement(row[4:7], row[1:4], row[0])
    return preintegrated


def imagine(dt_s: float, bias: Any, frame: Frame, noise: Noise) -> Any:
    """The motion model over `dt_s`."""
    params = _params(np.zeros(3), frame, noise, TURN_SIGMA_RPS, noise.motion_mps2)
    preintegrated = gtsam.PreintegratedCombinedMeasurements(params, bias)
    steps = max(round(dt_s / FICTION_STEP_S), 2)
    for _ in range(steps):
        preintegrated.integrateMeasurement(bias.accelerometer(), bias.gyroscope(), dt_s / steps)
    return preintegrated


def _params(gravity: Vector, frame: Frame, noise: Noise, gyro: float, accel: float) -> Any:
    params = gtsam.PreintegrationCombinedParams(gravity)
    unit = np.eye(3)
    params.setGyroscopeCovariance(unit * gyro**2)
    params.setAccelerometerCovariance(unit * accel**2)
    params.setIntegrationCovariance(unit * INTEGRATION_M**2)
    params.setBiasOmegaCovariance(unit * noise.gyro_walk**2)
    params.setBiasAccCovariance(unit * noise.accel_walk**2)
    params.setOmegaCoriolis(frame.earth_rate())
    return params
