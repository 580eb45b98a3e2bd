"""Measurements other than ranges as factors; keys are letters with the number of an epoch.

x pose (body to local), v velocity, b IMU biases, c receiver clock (a number, in seconds as GTSAM
wants it) and d its drift (a vector of one, which GTSAM's bindings insert ten times faster), counted
from where they were when the graph began; per block of time h the barometer's offset, w the wind.
"""

import math
from functools import lru_cache
from typing import Any

import gtsam
import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fusion.config import FusionConfig
from analysis.fusion.frame import Frame
from analysis.fusion.window import key
from analysis.gnss import LIGHT_MPS
from analysis.samples import Vector

EPOCHS = 1024  # numbers of epochs are used again after so many: at most that in a window
ONE = np.ones((1, 1))
NOTHING = np.zeros(1)


def sigma1(sigma: float) -> Any:
    """The noise of a scalar."""
    return gtsam.noiseModel.Isotropic.Sigma(1, sigma)


@lru_cache(maxsize=EPOCHS)
def clock_origin(epoch: int) -> Any:
    """An epoch's clock and drift as they were when the graph began: both are linear.

    Kept, since the bindings take 50 us to insert a number; not to be changed.
    """
    values = gtsam.Values()
    values.insert(key("c", epoch), 0.0)
    values.insert(key("d", epoch), NOTHING)
    return values


def clock_factors(
    before: int, epoch: int, origin: Any, dt_s: float, jumped_s: float, detector: DetectorConfig
) -> list[Any]:
    """The receiver's clock from one epoch to another; `jumped_s` is how far it may have leapt.

    `origin` has the values of both epochs' `clock_origin`.
    """
    noise, root = detector.noise, math.sqrt(dt_s)
    walk_s = math.hypot(noise.clock_m * root, noise.drift_mps * dt_s * root) / LIGHT_MPS
    sigmas = math.hypot(walk_s, jumped_s), noise.drift_mps * root / LIGHT_MPS
    c0, c1, d0, d1 = key("c", before), key("c", epoch), key("d", before), key("d", epoch)
    rows = (
        gtsam.JacobianFactor(c1, ONE, c0, -ONE, d0, -dt_s * ONE, NOTHING, _diagonal(sigmas[0])),
        gtsam.JacobianFactor(d1, ONE, d0, -ONE, NOTHING, _diagonal(sigmas[1])),
    )
    return [gtsam.LinearContainerFactor(row, origin) for row in rows]


def walk_factor(before: int, after: int, sigma: float) -> Any:
    """A number that walks."""
    origin = gtsam.Values()
    origin.insert(before, 0.0)
    origin.insert(after, 0.0)
    row = gtsam.JacobianFactor(after, ONE, before, -ONE, NOTHING, _diagonal(sigma))
    return gtsam.LinearContainerFactor(row, origin)


@lru_cache(maxsize=64)
def _diagonal(sigma: float) -> Any:
    return gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma]))


def baro_factor(epoch: int, offset: int, altitude_m: float, config: FusionConfig) -> Any:
    """A pressure altitude with the offset of a key; GTSAM wants the pressure of its own standard
    atmosphere for it."""
    pressure = gtsam.BarometricFactor().baroOut(altitude_m)
    return gtsam.BarometricFactor(key("x", epoch), offset, pressure, sigma1(config.baro_m))


def mag_factor(epoch: int, field_b_gauss: Vector, frame: Frame, config: FusionConfig) -> Any:
    """The field in body axes against the world's magnetic model."""
    field = frame.field_gauss
    size = float(np.linalg.norm(field))
    noise = gtsam.noiseModel.Isotropic.Sigma(3, config.mag_gauss)
    return gtsam.MagPoseFactorPose3(
        key("x", epoch), field_b_gauss, size, field / size, np.zeros(3), noise
    )


def airspeed_factor(epoch: int, wind: int, speed_mps: float, config: FusionConfig) -> Any:
    """The speed through the air: the length of velocity less the wind of a key."""
    velocity = key("v", epoch)

    def error(_: Any, values: Any, jacobians: Any) -> Vector:
        air = values.atPoint3(velocity) - values.atPoint3(wind)
        size = max(float(np.linalg.norm(air)), 1e-3)
        if jacobians is not None:
            jacobians[0] = (air / size)[None, :]
            jacobians[1] = -(air / size)[None, :]
        return np.array([size - speed_mps])

    return gtsam.CustomFactor(sigma1(config.airspeed_mps), [velocity, wind], error)
