"""The error model that all sensors share: white noise, bias, drift, random walk and scale.

A measured value is (1 + scale) * true + bias + drift + walk + white. The drift is a first-order
Gauss-Markov process. Errors are generated in blocks, as drawing them one by one is too slow.
"""

import math
from typing import NamedTuple

import numpy as np

from mavproxy_fault.documents.document_check import NotNegative, Positive, Section
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled

# Two seconds of an IMU at 250 Hz: long enough to amortise the calls to numpy, short enough to keep
# a state small.
BLOCK = 512


@compiled
def _gauss_markov(start: Array, phi: float, draws: Array) -> Array:
    """x[k+1] = phi x[k] + draws[k], for each column of `draws` (n, m)."""
    out = np.empty_like(draws)
    last = start.copy()
    for k in range(draws.shape[0]):
        for i in range(draws.shape[1]):
            last[i] = phi * last[i] + draws[k, i]
            out[k, i] = last[i]
    return out


class NoiseState(NamedTuple):
    """The errors (n, m) of the coming samples, and bias, drift and walk (m,) after them."""

    block: Array
    bias: Array
    drift: Array
    walk: Array


class NoiseModel(Section, frozen=True):
    """The errors of one channel, or of several channels alike, in the sensor's unit.

    Parameters
    ----------
    sigma : float
        White noise per sample.
    density : float
        White noise per root hertz (an angle or velocity random walk); adds to `sigma`.
    bias : float or list
        Constant error, for all channels or for each.
    bias_sigma : float
        Standard deviation of a constant error drawn for each flight and channel.
    drift_sigma, drift_time_s : float
        Stationary standard deviation and time constant of the Gauss-Markov drift.
    walk : float
        Random walk of the error per root second.
    scale : float
        Scale factor error, relative.
    """

    sigma: NotNegative = 0.0
    density: NotNegative = 0.0
    bias: float | list[float] = 0.0
    bias_sigma: NotNegative = 0.0
    drift_sigma: NotNegative = 0.0
    drift_time_s: Positive = 100.0
    walk: NotNegative = 0.0
    scale: float = 0.0

    def new_state(self, rng: np.random.Generator, channels: int, rate_hz: float) -> NoiseState:
        """Draw the constant errors and the first block."""
        bias = np.broadcast_to(np.asarray(self.bias, dtype=float), (channels,)).copy()
        if self.bias_sigma > 0.0:
            # Drawn only if configured and in this order: the flight's bytes depend on both.
            bias = bias + self.bias_sigma * rng.standard_normal(channels)
        drift = np.zeros(channels)
        if self.drift_sigma > 0.0:
            # Drawn from the stationary distribution, as for a sensor long switched on.
            drift = self.drift_sigma * rng.standard_normal(channels)
        start = NoiseState(np.empty(0), bias, drift, np.zeros(channels))
        return self.refill(start, rng, rate_hz)

    def refill(self, state: NoiseState, rng: np.random.Generator, rate_hz: float) -> NoiseState:
        """Draw the errors of the next block."""
        _, bias, drift, walk = state
        shape = (BLOCK, len(bias))
        block = np.broadcast_to(bias, shape).copy()
        # White noise of density N sampled at f has variance N^2 f, which adds to sigma^2.
        white = math.hypot(self.sigma, self.density * math.sqrt(rate_hz))
        if white > 0.0:
            block += white * rng.standard_normal(shape)
        if self.drift_sigma > 0.0:
            phi = math.exp(-1.0 / (self.drift_time_s * rate_hz))
            # This standard deviation per step keeps the process stationary.
            kick = self.drift_sigma * math.sqrt(1.0 - phi * phi)
            path = _gauss_markov(drift, phi, kick * rng.standard_normal(shape))
            block += path
            drift = path[-1]
        if self.walk > 0.0:
            path = walk + np.cumsum(self.walk / math.sqrt(rate_hz) * rng.standard_normal(shape), 0)
            block += path
            walk = path[-1]
        return NoiseState(block, bias, drift, walk)
