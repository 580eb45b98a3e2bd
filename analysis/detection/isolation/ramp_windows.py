"""Ramp tests: growing faults, which the filter follows, and so hides, epoch by epoch.

The likelihood ratio of each satellite's fault since the start of each window [1]_ equals that of a
sub-filter with its own memory, without running one. The equations, with the satellites' offsets and
the rival hypothesis, are in docs/fdi.md, "Ramp tests".

References
----------
.. [1] A. S. Willsky and H. L. Jones, IEEE Trans. Automatic Control 21(1), 1976.
"""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import R, V
from analysis.detection.filter.information import EpochUpdate, NormalEquations, covariance_block
from analysis.detection.filter.lasting_errors import INDEPENDENT_AFTER_S
from analysis.detection.filter.range_noise import SigmaModel
from analysis.detection.statistics.bank import cholesky_reduction
from analysis.samples.block import Indices
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

# Four windows look back 15 to 20 s: a ramp of 0.5 m/s has then grown to 10 m, ten sigma.
WINDOW_COUNT, STRIDE_S = 4, 5.0
YOUNGEST_S = 0.5  # younger windows take a carry-off at 1 m/s for the receiver or the IMU


class RampWindows(NamedTuple):
    """w staggered windows of the ramp tests over n satellites.

    `starts_us` (w,) is when each began (0: not yet); `d` (20, w, n + 3) are each window's
    responses of the filter's state to ramps of n satellites, then to accelerations along x, y, z.
    `sums` (5, w, n) are scores and information of a ramp and an offset: c_r, c_o, J_rr, J_ro, J_oo;
    `c` (w, 3) and `j` (w, 3, 3) those of the accelerations. `offset` and `spread` (n,) are mean and
    variance of each satellite's range offset now,
    `offsets` and `spreads` (w, n) the same when a window began.
    """

    starts_us: Indices
    d: Vector
    sums: Vector
    c: Vector
    j: Vector
    offset: Vector
    spread: Vector
    offsets: Vector
    spreads: Vector


class StrongestRamp(NamedTuple):
    """The largest likelihood ratio of a ramp, its window and satellite (-1: no window is old
    enough), and that of the rival, a wrong acceleration."""

    ramp: float
    window: int
    satellite: int
    rival: float


def update_windows(
    windows: RampWindows,
    motion: MotionEstimate,
    update: EpochUpdate,
    transition: Vector,
    dt_s: float,
    config: DetectorConfig,
) -> tuple[RampWindows, StrongestRamp]:
    """The windows after the filter's `update` of its prediction `motion`, which came from the last
    epoch by a transition (20, 20) of errors over `dt_s`, and the strongest ramp that they show."""
    ages_s = np.where(windows.starts_us != 0, (motion.t_us - windows.starts_us) * 1e-6, 0.0)
    prior = covariance_block(motion.p, update.ranges.states)
    offset, spread = learn_offsets(windows, prior, update.ranges, dt_s, config.sigma)
    windows = propagate_windows(windows, transition, dt_s)
    respond(windows, ages_s, update.ranges, *update.after_ranges, True)
    respond(windows, ages_s, update.rates, *update.after_rates, False)
    windows = windows._replace(offset=offset, spread=spread)
    variances = float(config.sigma.slow_mps) ** 2, float(config.slow_accel_mps2) ** 2
    strongest = strongest_ramp(windows, ages_s, motion.inertial, *variances)
    return windows, StrongestRamp(*strongest)


def propagate_windows(windows: RampWindows, transition: Vector, dt_s: float) -> RampWindows:
    """Every window, as new arrays, after the transition (20, 20) over `dt_s`."""
    d = (transition @ windows.d.reshape(len(transition), -1)).reshape(windows.d.shape)
    for axis in range(3):
        # Half a t^2 of position and t of velocity per second of acceleration.
        d[R + axis, :, axis - 3] += 0.5 * dt_s**2
        d[V + axis, :, axis - 3] += dt_s
    c, j = windows.c.copy(), windows.j.copy()
    return windows._replace(d=d, sums=windows.sums.copy(), c=c, j=j)


@compiled
def respond(
    windows: RampWindows,
    ages_s: Vector,
    used: NormalEquations,
    after: Vector,
    fit: Vector,
    ramps: bool,
) -> None:
    """Add one epoch to every window, in place.

    `ages_s` (w,) are the times since each window's start, `after` (20, c) and `fit` (c, c) those of
    `EpochUpdate` for the n ranges, if `ramps`, or rates that were `used`: no fault of a range
    affects a rate.
    """
    d, sums, count = windows.d, windows.sums, windows.sums.shape[2] if ramps else 0
    each, size, states = d.shape[2], used.b.shape[0], used.states
    first = each - 3  # of the accelerations
    seen, gamma, whole = np.empty(size), np.empty((each, size)), np.empty((each, size))
    for w in range(ages_s.shape[0]):
        b, moved = _without_offsets(used, fit, windows.offsets[w, :count])
        for s in range(each):
            lost = 0.0
            for k in range(size):
                seen[k] = d[states[k], w, s]
            for k in range(size):
                gamma[s, k] = used.a[s, k] * ages_s[w] / used.variance[s] if s < count else 0.0
                for m in range(size):
                    gamma[s, k] -= used.information[k, m] * seen[m]
                lost += seen[k] * b[k] + gamma[s, k] * moved[k]
            for k in range(size):
                whole[s, k] = seen[k]
                for m in range(size):
                    whole[s, k] += fit[k, m] * gamma[s, m]
            # The response follows the update as the state does.
            for row in range(d.shape[0]):
                for k in range(size):
                    d[row, w, s] += after[row, k] * gamma[s, k]
            if s >= first:
                windows.c[w, s - first] -= lost
            if s < count:
                age, variance, cross = ages_s[w], used.variance[s], 0.0
                followed = mixed = shift = known = 0.0
                for k in range(size):
                    followed += used.a[s, k] * seen[k]
                    mixed += used.a[s, k] * whole[s, k]
                    shift += used.a[s, k] * moved[k]
                    cross += gamma[s, k] * whole[s, k]
                    for m in range(size):
                        known += used.a[s, k] * fit[k, m] * used.a[s, m]
                news = used.v[s] - windows.offsets[w, s]
                sums[0, w, s] += age * news / variance - lost
                sums[1, w, s] += (news - shift) / variance
                sums[2, w, s] += age * (age - followed) / variance - cross
                sums[3, w, s] += (age - mixed) / variance
                sums[4, w, s] += (1.0 - known / variance) / variance
        for k in range(size):
            for i in range(3):
                for j in range(3):
                    windows.j[w, i, j] -= whole[first + i, k] * gamma[first + j, k]


@compiled
def _without_offsets(used: NormalEquations, fit: Vector, offsets: Vector) -> tuple[Vector, Vector]:
    """b and F b (c,) of measurements less the offsets (n,) of a window."""
    b, moved = used.b.copy(), np.zeros(used.b.shape[0])
    for k in range(b.shape[0]):
        for i in range(offsets.shape[0]):
            b[k] -= used.a[i, k] * offsets[i] / used.variance[i]
    for k in range(b.shape[0]):
        for m in range(b.shape[0]):
            moved[k] += fit[k, m] * b[m]
    return b, moved


def learn_offsets(
    windows: RampWindows, prior: Vector, ranges: NormalEquations, dt_s: float, sigma: SigmaModel
) -> tuple[Vector, Vector]:
    """Mean and variance (n,) of each satellite's offset after the innovations of one epoch.

    `prior` (c, c) is the covariance of the observed states before it; an epoch `dt_s` after the
    last one counts min(dt_s / 1 s, 1) of an independent one.
    """
    stays, news = math.exp(-dt_s / sigma.slow_s), min(dt_s / INDEPENDENT_AFTER_S, 1.0)
    a, variance, mean = ranges.a, ranges.variance, stays * windows.offset
    # The process noise of a first-order Gauss-Markov process of that variance.
    fresh = (1.0 - stays * stays) * sigma.slow**2 * variance
    spread = stays * stays * windows.spread + fresh
    s = variance + ((a @ prior) * a).sum(axis=1)
    gain = spread / (spread + s / news)
    return mean + gain * (ranges.v - mean), spread * (1.0 - gain)


@compiled
def strongest_ramp(
    windows: RampWindows, ages_s: Vector, inertial: bool, slope: float, acceleration: float
) -> tuple[float, int, int, float]:
    """The largest ratio of a ramp, its window and satellite, and the largest ratio of the rival, an
    acceleration error, where an IMU is used; `ages_s` (w,). `slope` and `acceleration` are the
    variances of what is natural to a healthy satellite and to a healthy IMU."""
    best, window, satellite, rival = 0.0, -1, -1, 0.0
    for w in range(ages_s.shape[0]):
        if ages_s[w] >= YOUNGEST_S:
            for i in range(windows.offset.shape[0]):
                ratio = ramp_ratio(windows, w, i, slope)
                # The first window that is old enough counts even with a ratio of zero.
                if ratio > best or satellite < 0:
                    best, window, satellite = ratio, w, i
            if inertial:
                rival = max(rival, _acceleration_ratio(windows, w, acceleration))
    return best, window, satellite, rival


@compiled
def ramp_ratio(windows: RampWindows, w: int, i: int, slope: float) -> float:
    """The likelihood ratio of a ramp on satellite i in window w; `slope` is the variance of a
    healthy satellite's natural rate of change."""
    sums, spread = windows.sums, windows.spreads[w, i]
    # Without a spread the offset is known exactly and takes nothing off.
    shared = sums[3, w, i] * spread / (sums[4, w, i] * spread + 1.0)
    c = sums[0, w, i] - shared * sums[1, w, i]
    information = sums[2, w, i] - shared * sums[3, w, i]
    # A window without information has no ratio.
    return c * c / (information * (1.0 + slope * information)) if information > 1e-9 else 0.0


@compiled
def _acceleration_ratio(windows: RampWindows, w: int, prior: float) -> float:
    """The likelihood ratio of a constant acceleration error in window w; `prior` is the variance of
    a healthy IMU's error beyond its noise model."""
    j, covariance = windows.j[w], np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            # J^2: the prior's share of J, as k J^2 of a ramp.
            squared = j[a, 0] * j[0, b] + j[a, 1] * j[1, b] + j[a, 2] * j[2, b]
            covariance[a, b] = j[a, b] + prior * squared
        # Keeps the matrix invertible along an axis without information.
        covariance[a, a] += 1e-9
    if j[0, 0] + j[1, 1] + j[2, 2] <= 1e-6:
        return 0.0
    return max(cholesky_reduction(covariance, windows.c[w].copy()), 0.0)
