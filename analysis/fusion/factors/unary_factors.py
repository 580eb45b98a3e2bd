"""Factors of measurements other than ranges; keys are letters with the number of an epoch.

x pose (body to local), v velocity, b IMU biases, c receiver clock and drift (in m and m/s, relative
to those at the graph's start); per span of the window h the barometer's offset (in km, see
`OFFSET_UNIT_M`), w the wind.

GTSAM's factors take a clock in seconds and an offset in metres, which makes the system badly
conditioned. Such factors, which are almost linear, are linear ones with scaled columns here.
"""

from functools import lru_cache
from typing import Any

import gtsam
import numpy as np

from analysis.detection.filter.filter_config import ProcessNoise
from analysis.fusion.local_frame import LocalFrame
from analysis.fusion.window import variable_key
from analysis.samples.sample import Vector

MAX_EPOCHS = 1024  # in a window: at 5 Hz and a lag of 5 s, 50 are in use
# GTSAM's Cholesky treats a last pivot 2^12 times smaller than the previous one as zero, as that of
# an offset in metres would be next to the gyro biases.
OFFSET_UNIT_M = 1000.0
NO_CLOCK, NO_OFFSET, NO_MAG_BIAS = np.zeros(2), np.zeros(1), np.zeros(3)


@lru_cache(maxsize=MAX_EPOCHS)
def isotropic_noise(size: int, sigma: float) -> Any:
    """Noise of a vector whose components have the same sigma."""
    return gtsam.noiseModel.Isotropic.Sigma(size, sigma)


@lru_cache(maxsize=MAX_EPOCHS)
def unit_noise(rows: int) -> Any:
    """Noise of whitened rows."""
    return gtsam.noiseModel.Unit.Create(rows)


@lru_cache(maxsize=MAX_EPOCHS)
def clock_factor(before: int, epoch: int, dt_s: float, jumped_m: float, noise: ProcessNoise) -> Any:
    """The receiver's clock between two epochs; `jumped_m` is how far it may have jumped."""
    walk, drift = noise.clock_m**2, noise.drift_mps**2
    cross = drift * dt_s**2 / 2.0
    own = walk * dt_s + drift * dt_s**3 / 3.0 + jumped_m**2
    covariance = np.array([[own, cross], [cross, drift * dt_s]])
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    step = np.array([[1.0, dt_s], [0.0, 1.0]])
    c0, c1 = variable_key("c", before), variable_key("c", epoch)
    row = gtsam.JacobianFactor(c1, whiten, c0, -whiten @ step, NO_CLOCK, unit_noise(2))
    return _linear_at_zero(row, NO_CLOCK, c0, c1)


def walk_factor(before: int, after: int, sigma: float, size: int) -> Any:
    """Random walk of a vector from one key to another."""
    share = np.eye(size) / sigma
    zero = np.zeros(size)
    row = gtsam.JacobianFactor(after, share, before, -share, zero, unit_noise(size))
    return _linear_at_zero(row, zero, before, after)


def _linear_at_zero(row: Any, zero: Vector, *keys: int) -> Any:
    origin = gtsam.Values()
    for name in keys:
        origin.insert(name, zero)
    return gtsam.LinearContainerFactor(row, origin)


def baro_factor(epoch: int, pose: Any, offset: int, altitude_m: float, sigma_m: float) -> Any:
    """A pressure altitude with the offset of a key: z + offset - altitude, linearised at a pose."""
    x, origin = variable_key("x", epoch), gtsam.Values()
    origin.insert(x, pose)
    origin.insert(offset, NO_OFFSET)
    # A pose's translation errors are in body axes.
    by_pose = np.hstack([np.zeros(3), pose.rotation().matrix()[2]])[None, :] / sigma_m
    by_offset, right_side = np.array([[OFFSET_UNIT_M], [altitude_m - pose.z()]]) / sigma_m
    row = gtsam.JacobianFactor(x, by_pose, offset, by_offset[None, :], right_side, unit_noise(1))
    return gtsam.LinearContainerFactor(row, origin)


def mag_factor(epoch: int, field_b_gauss: Vector, frame: LocalFrame, sigma_gauss: float) -> Any:
    """The field (3,) in body axes, compared with the World Magnetic Model."""
    field, noise = frame.field_gauss, isotropic_noise(3, sigma_gauss)
    size = float(np.linalg.norm(field))  # GTSAM uses only the direction of its third argument
    return gtsam.MagPoseFactorPose3(
        variable_key("x", epoch), field_b_gauss, size, field, NO_MAG_BIAS, noise
    )


def airspeed_factor(epoch: int, wind: int, speed_mps: float, sigma_mps: float) -> Any:
    """Airspeed: the distance between the velocity and the wind of a key."""
    return gtsam.RangeFactor3(
        variable_key("v", epoch), wind, speed_mps, isotropic_noise(1, sigma_mps)
    )
