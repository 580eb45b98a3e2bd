"""Single pseudorange factors with GTSAM's robust losses, for comparison with exclusions.

They use the receiver's clock in seconds: a variable r, tied to the one in metres.
"""

from typing import Any

import gtsam
import numpy as np

from analysis.fusion.factors.range_factors import EpochRanges
from analysis.fusion.factors.unary_factors import NO_CLOCK, unit_noise
from analysis.fusion.graph_start import ClockState
from analysis.fusion.local_frame import LocalFrame
from analysis.fusion.window import variable_key
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS

HUBER_SIGMAS = 1.345  # 95 % efficiency for normal noise (Huber 1964)
GEMAN_SIGMAS = 3.0  # as `suspicious` of `FusionConfig`, at which weights begin to fall
CLOCK_TIE_M = 0.05  # far below a range's sigma


def pseudorange_factors(
    ranges: EpochRanges,
    weights: Vector,
    epoch: int,
    frame: LocalFrame,
    clock: ClockState,
    robust: str,
) -> dict[str, Any]:
    """Factors by satellite of nonzero weight (n,), on pose and clock in seconds of an epoch."""
    x, r = variable_key("x", epoch), variable_key("r", epoch)
    return {
        ranges.satellites[i]: ranges.pseudorange(
            i, x, r, frame, clock, _loss(robust, ranges.sigma_m[i])
        )
        for i in np.flatnonzero(weights).tolist()
    }


def clock_seconds_factor(epoch: int) -> tuple[Any, Any]:
    """The clock in seconds with its initial value, and the factor that ties it to metres."""
    # Initialised to zero: the tie below sets it at once.
    c, r = variable_key("c", epoch), variable_key("r", epoch)
    guess = gtsam.Values()
    guess.insert(r, 0.0)
    origin = gtsam.Values(guess)
    origin.insert(c, NO_CLOCK)
    row = gtsam.JacobianFactor(
        c,
        np.array([[1.0 / CLOCK_TIE_M, 0.0]]),
        r,
        np.array([[-SPEED_OF_LIGHT_MPS / CLOCK_TIE_M]]),
        np.zeros(1),
        unit_noise(1),
    )
    return guess, gtsam.LinearContainerFactor(row, origin)


def _loss(robust: str, sigma_m: float) -> Any:
    noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma_m)
    estimator = gtsam.noiseModel.mEstimator
    if robust == "huber":
        return gtsam.noiseModel.Robust.Create(estimator.Huber.Create(HUBER_SIGMAS), noise)
    if robust == "geman-mcclure":
        return gtsam.noiseModel.Robust.Create(estimator.GemanMcClure.Create(GEMAN_SIGMAS), noise)
    # Without a loss: the Gaussian noise of the range.
    return noise
