"""Measurements other than ranges as factors; keys are letters with the number of an epoch.

x pose (body to local), v velocity, b IMU biases, c receiver clock and drift (in m and m/s, counted
from where they were when the graph began); per span of the window h the barometer's offset (in km,
see `OFFSET_UNIT_M`), w the wind.

GTSAM's factors take a clock in seconds and an offset in metres as numbers of their own. Beside
metres that ruins the condition of the system, so such factors are linearised here, where they are
made, and enter the graph as linear ones with scaled columns; both are as good as linear.
"""

from functools import lru_cache
from typing import Any

import gtsam
import numpy as np

from analysis.detection.filter.process_noise import ProcessNoise
from analysis.fusion.local_frame import LocalFrame
from analysis.fusion.window import variable_key
from analysis.samples.sample import Vector

MAX_EPOCHS = 1024  # at most that many in a window
PLACEHOLDER = gtsam.symbol("a", 0)  # in the place of a variable that is a vector in the graph
# GTSAM's Cholesky takes a last pivot 2^12 times smaller than the one before it for a zero. In
# metres an offset would be that beside the gyro's biases.
OFFSET_UNIT_M = 1000.0
NO_CLOCK, NO_OFFSET, NO_MAG_BIAS = np.zeros(2), np.zeros(1), np.zeros(3)
STANDARD_AIR = gtsam.BarometricFactor()


@lru_cache(maxsize=MAX_EPOCHS)
def isotropic_noise(size: int, sigma: float) -> Any:
    """The noise of a vector whose parts have the same sigma."""
    return gtsam.noiseModel.Isotropic.Sigma(size, sigma)


@lru_cache(maxsize=MAX_EPOCHS)
def unit_noise(rows: int) -> Any:
    """The noise of rows that are divided by their sigmas."""
    return gtsam.noiseModel.Unit.Create(rows)


@lru_cache(maxsize=MAX_EPOCHS)
def clock_factor(before: int, epoch: int, dt_s: float, jumped_m: float, noise: ProcessNoise) -> Any:
    """The receiver's clock from one epoch to another; `jumped_m` is how far it may have leapt."""
    walk, drift = noise.clock_m**2, noise.drift_mps**2
    cross = drift * dt_s**2 / 2.0
    own = walk * dt_s + drift * dt_s**3 / 3.0 + jumped_m**2
    spread = np.array([[own, cross], [cross, drift * dt_s]])
    whiten = np.linalg.inv(np.linalg.cholesky(spread))
    step = np.array([[1.0, dt_s], [0.0, 1.0]])
    c0, c1 = variable_key("c", before), variable_key("c", epoch)
    row = gtsam.JacobianFactor(c1, whiten, c0, -whiten @ step, NO_CLOCK, unit_noise(2))
    return _linear_at_zero(row, NO_CLOCK, c0, c1)


def walk_factor(before: int, after: int, sigma: float, size: int) -> Any:
    """A vector that walks from one key to another."""
    share = np.eye(size) / sigma
    zero = np.zeros(size)
    row = gtsam.JacobianFactor(after, share, before, -share, zero, unit_noise(size))
    return _linear_at_zero(row, zero, before, after)


def _linear_at_zero(row: Any, zero: Vector, *keys: int) -> Any:
    origin = gtsam.Values()
    for name in keys:
        origin.insert(name, zero)
    return gtsam.LinearContainerFactor(row, origin)


@lru_cache(maxsize=1)
def _placeholder_values() -> Any:
    """`PLACEHOLDER` at zero; not to be changed. The bindings take 70 us to insert a number."""
    values = gtsam.Values()
    values.insert(PLACEHOLDER, 0.0)
    return values


def baro_factor(epoch: int, pose: Any, offset: int, altitude_m: float, sigma_m: float) -> Any:
    """A pressure altitude with the offset of a key, linearised at a pose; GTSAM wants the pressure
    of its own standard atmosphere for it."""
    pressure = STANDARD_AIR.baroOut(altitude_m)
    x = variable_key("x", epoch)
    factor = gtsam.BarometricFactor(x, PLACEHOLDER, pressure, isotropic_noise(1, sigma_m))
    origin = gtsam.Values(_placeholder_values())
    origin.insert(x, pose)
    origin.insert(offset, NO_OFFSET)
    jacobian, wanted = factor.linearize(origin).jacobian()  # by pose, then number
    by_offset = jacobian[:, 6:] * OFFSET_UNIT_M
    row = gtsam.JacobianFactor(x, jacobian[:, :6], offset, by_offset, wanted, unit_noise(1))
    return gtsam.LinearContainerFactor(row, origin)


def mag_factor(epoch: int, field_b_gauss: Vector, frame: LocalFrame, sigma_gauss: float) -> Any:
    """The field (3,) in body axes against the world's magnetic model."""
    field, noise = frame.field_gauss, isotropic_noise(3, sigma_gauss)
    size = float(np.linalg.norm(field))  # GTSAM takes the direction alone of its third argument
    return gtsam.MagPoseFactorPose3(
        variable_key("x", epoch), field_b_gauss, size, field, NO_MAG_BIAS, noise
    )


def airspeed_factor(epoch: int, wind: int, speed_mps: float, sigma_mps: float) -> Any:
    """The speed through the air: how far the velocity is from the wind of a key."""
    return gtsam.RangeFactor3(
        variable_key("v", epoch), wind, speed_mps, isotropic_noise(1, sigma_mps)
    )
