"""Ramp tests: growing faults, which the filter follows, and so hides, epoch by epoch.

A fault of one satellite that grows since t_0 adds r (t - t_0) to its range. What that does to the
filter is linear: with D the response of the estimated state, of every innovation g = e s - H D, and

    D <- Phi D,  then  D <- D + K g,

so c = sum g' M v and J = sum g' M g over the epochs since t_0 (M the inverse innovation covariance)
give the fault's likeliest slope c / J and the likelihood ratio c^2 / J, chi-square(1) without a
fault [1]_. This equals a bank of sub-filters of their own memory, each with one satellite's fault
set free since t_0, without running them. Several windows start `STRIDE_S` apart.

The innovations of a healthy satellite have an offset that stays for minutes (multipath, ephemeris,
atmosphere). Each satellite's is learned as a first-order Gauss-Markov process, mean o and variance
B, and the offset known when a window started is subtracted: with v - o in place of v and the rest
of the offset marginalised,

    J = J_rr - J_ro^2 / (J_oo + 1/B),   c = c_r - J_ro c_o / (J_oo + 1/B),

and a natural slope of variance k makes the test c^2 / (J + k J^2). A faulty accelerometer or a
wrong attitude shows as a constant acceleration: three more responses, the rival hypothesis.

The innovations are never formed: with N, b and P+ of `information`, D_c the response of the states
that are observed and gamma = A' inv(R) g = A' inv(R) e s - N D_c,

    K g = P+_:c gamma,
    g' M v = g' inv(R) v - gamma' P+_c b,   g' M g = g' inv(R) g - gamma' P+_c gamma.

References
----------
.. [1] A. S. Willsky and H. L. Jones, IEEE Trans. Automatic Control 21(1), 1976.
"""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.inertial import V
from analysis.detection.filter.information import Indices, NormalEquations, row_quadratic_form
from analysis.detection.filter.lasting_errors import INDEPENDENT_AFTER_S
from analysis.detection.statistics.bank import cholesky_reduction
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.linear import add_product, multiply_matrices, multiply_vector

WINDOW_COUNT = 4
STRIDE_S = 5.0  # four windows look back 15 to 20 s
YOUNGEST_S = 0.5  # a younger window detects nothing that the main test does not


class RampNumbers(NamedTuple):
    """Assumptions of the ramp tests on a healthy satellite and a healthy IMU.

    An unknown offset's variance over that of the range and its correlation time, the variance of a
    natural slope (m/s)^2, and that of a healthy IMU's acceleration error (m/s^2)^2.
    """

    offset_share: float
    offset_s: float
    slope: float
    acceleration: float


class RampWindows(NamedTuple):
    """w windows of the ramp tests over n satellites.

    `starts_us` (w,) is when each began (0: not yet); `d` (20, w s) are the responses of the state
    in each to s = n + 3 signatures, ramps of n satellites, then accelerations along x, y, z; `sums`
    (w, 5 n + 12) are c_r, c_o, J_rr, J_ro, J_oo, then c and J (3, 3) of the accelerations. `offset`
    and `spread` (n,) are mean and variance of each satellite's offset now, `offsets` and `spreads`
    (w, n) the same when a window began.
    """

    starts_us: Indices
    d: Vector
    sums: Vector
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


class WindowResponse(NamedTuple):
    """Over the c observed states: D_c, gamma, and D_c + P+_c gamma (c, w s)."""

    seen: Vector
    gamma: Vector
    whole: Vector


class WindowInnovations(NamedTuple):
    """Innovations less a window's offsets: over their variance (n,), b (c,) and P+_c b (c,)."""

    weighted: Vector
    b: Vector
    moved: Vector


@compiled
def respond_to_ranges(
    windows: RampWindows,
    ages: Vector,
    phi: Vector,
    after: Vector,
    ranges: NormalEquations,
    dt_s: float,
) -> tuple[Vector, Vector]:
    """Add one epoch of ranges to every window: d and sums after it, as new arrays.

    `ages` (w,) are seconds since each window's start, phi (20, 20) the transition since the last
    epoch, `dt_s` ago, and `after` (20, c) the columns of the observed states of the covariance
    after this one.
    """
    count = windows.offsets.shape[1]
    each = count + 3
    d = multiply_matrices(phi, windows.d)
    for w in range(ages.shape[0]):
        for axis in range(3):
            at = w * each + count + axis
            # Half a t^2 of position and t of velocity per second of acceleration.
            d[axis, at] += 0.5 * dt_s * dt_s
            d[V + axis, at] += dt_s
    sums, known = windows.sums.copy(), _rows(after, ranges.states)
    seen, gamma = _seen(d, ranges)
    a, variances, own = ranges.a, ranges.variance, np.empty(count)
    for i in range(count):
        variance = variances[i]
        own[i] = (1.0 - row_quadratic_form(a, i, known) / variance) / variance
        for k in range(gamma.shape[0]):
            share = a[i, k] / variance
            for w in range(ages.shape[0]):
                gamma[k, w * each + i] += share * ages[w]
    response = WindowResponse(seen, gamma, _whole(seen, gamma, known))
    for w in range(ages.shape[0]):
        for i in range(count):
            # J_oo: an epoch adds the same to every window, but each sums since its own start.
            sums[w, 4 * count + i] += own[i]
        news = _window_innovations(windows.offsets[w], ranges, known)
        first = w * each
        _add_ramps(sums[w], response, first, ranges, ages[w], news)
        _add_accelerations(sums[w], response, first + count, news.b, news.moved)
    # The response follows the update as the state does, after the sums were formed with it.
    add_product(d, 1.0, after, gamma)
    return d, sums


@inlined
def _window_innovations(
    offsets: Vector, ranges: NormalEquations, known: Vector
) -> WindowInnovations:
    """The ranges less the offsets (n,) of a window; `known` (c, c) is P+_c."""
    weighted, b = np.empty(offsets.shape[0]), np.zeros(known.shape[0])
    a, v, variance = ranges.a, ranges.v, ranges.variance
    for i in range(weighted.shape[0]):
        weighted[i] = (v[i] - offsets[i]) / variance[i]
        for k in range(b.shape[0]):
            b[k] += a[i, k] * weighted[i]
    return WindowInnovations(weighted, b, multiply_vector(known, b))


@inlined
def _rows(m: Vector, which: Indices) -> Vector:
    """The rows `which` of a matrix."""
    out = np.empty((which.shape[0], m.shape[1]))
    for i in range(which.shape[0]):
        for j in range(m.shape[1]):
            out[i, j] = m[which[i], j]
    return out


@inlined
def _seen(d: Vector, normal: NormalEquations) -> tuple[Vector, Vector]:
    """D_c and -N D_c (c, w s)."""
    seen = _rows(d, normal.states)
    gamma = np.zeros_like(seen)
    add_product(gamma, -1.0, normal.information, seen)
    return seen, gamma


@inlined
def _whole(seen: Vector, gamma: Vector, known: Vector) -> Vector:
    """D_c + P+_c gamma (c, w s)."""
    whole = multiply_matrices(known, gamma)
    for k in range(seen.shape[0]):
        for j in range(seen.shape[1]):
            whole[k, j] += seen[k, j]
    return whole


@inlined
def _add_ramps(
    row: Vector,
    response: WindowResponse,
    first: int,
    ranges: NormalEquations,
    age_s: float,
    news: WindowInnovations,
) -> None:
    """Add an epoch to a window's sums of ramps and c_o, in place; its ramps are the columns from
    `first`."""
    weighted, b, moved = news
    seen, gamma, whole = response
    a, variances, count = ranges.a, ranges.variance, weighted.shape[0]
    for i in range(count):
        followed = mixed = cross = known = offset = 0.0
        for k in range(b.shape[0]):
            response_k, own, both = seen[k, first + i], gamma[k, first + i], whole[k, first + i]
            followed += a[i, k] * response_k
            mixed += a[i, k] * both
            cross += own * both
            known += response_k * b[k] + own * moved[k]
            offset += a[i, k] * moved[k]
        variance = variances[i]
        row[i] += age_s * weighted[i] - known
        row[count + i] += weighted[i] - offset / variance
        row[2 * count + i] += age_s * (age_s - followed) / variance - cross
        row[3 * count + i] += (age_s - mixed) / variance


@inlined
def _add_accelerations(
    row: Vector, response: WindowResponse, first: int, b: Vector, moved: Vector
) -> None:
    """Add to c and J of the accelerations, the last 12 of `row`, in place; theirs are the columns
    from `first`, `moved` is P+_c b."""
    to = row.shape[0] - 12
    seen, gamma, whole = response
    for k in range(b.shape[0]):
        for i in range(3):
            row[to + i] -= seen[k, first + i] * b[k] + gamma[k, first + i] * moved[k]
            for j in range(3):
                row[to + 3 + 3 * i + j] -= whole[k, first + i] * gamma[k, first + j]


@compiled
def respond_to_rates(d: Vector, sums: Vector, after: Vector, rates: NormalEquations) -> None:
    """Add one epoch of Doppler rates, which no fault of a range affects: accelerations alone. d
    (20, w s) and sums (w, 5 n + 12) change in place; `after` (20, c) as for ranges."""
    count = (sums.shape[1] - 12) // 5
    known = _rows(after, rates.states)
    seen, gamma = _seen(d, rates)
    response, moved = (
        WindowResponse(seen, gamma, _whole(seen, gamma, known)),
        multiply_vector(known, rates.b),
    )
    for w in range(sums.shape[0]):
        _add_accelerations(sums[w], response, w * (count + 3) + count, rates.b, moved)
    add_product(d, 1.0, after, gamma)


@compiled
def learn_offsets(
    windows: RampWindows, prior: Vector, ranges: NormalEquations, dt_s: float, numbers: RampNumbers
) -> tuple[Vector, Vector]:
    """Mean and variance (n,) of each satellite's offset after the innovations of one epoch.

    `prior` (c, c) is the covariance of the observed states before it; an epoch `dt_s` after the
    last one counts min(dt_s / 1 s, 1) of an independent one.
    """
    stays, news = math.exp(-dt_s / numbers.offset_s), min(dt_s / INDEPENDENT_AFTER_S, 1.0)
    mean, spread = windows.offset.copy(), windows.spread.copy()
    a, v, variance = ranges.a, ranges.v, ranges.variance
    for i in range(mean.shape[0]):
        mean[i] *= stays
        # The process noise of a first-order Gauss-Markov process of that variance.
        fresh = (1.0 - stays * stays) * numbers.offset_share * variance[i]
        spread[i] = stays * stays * spread[i] + fresh
        s = variance[i] + row_quadratic_form(a, i, prior)
        gain = spread[i] / (spread[i] + s / news)
        mean[i] += gain * (v[i] - mean[i])
        spread[i] *= 1.0 - gain
    return mean, spread


@compiled
def strongest_ramp(
    windows: RampWindows, ages: Vector, inertial: bool, numbers: RampNumbers
) -> StrongestRamp:
    """The largest ratio of a ramp, and the largest of the rival, an acceleration error, where an
    IMU is used; `ages` (w,) in s."""
    best, window, satellite, rival = 0.0, -1, -1, 0.0
    ramps = ramp_statistics(windows.sums, windows.spreads, numbers.slope)
    wrong = np.zeros(ages.shape[0])
    if inertial:
        wrong = acceleration_statistics(windows.sums, numbers.acceleration)
    for w in range(ages.shape[0]):
        if ages[w] >= YOUNGEST_S:
            rival = max(rival, wrong[w])
            for j in range(ramps.shape[1]):
                # `satellite < 0`: the first window that is old enough counts even with a ratio of
                # zero.
                if ramps[w, j] > best or satellite < 0:
                    best, window, satellite = ramps[w, j], w, j
    return StrongestRamp(best, window, satellite, rival)


@compiled
def ramp_statistics(sums: Vector, spread: Vector, slope: float) -> Vector:
    """Likelihood ratios (w, n) of a ramp on each satellite.

    `spread` (w, n) is the variance of the unknown part of a healthy satellite's offset, `slope`
    that of its natural rate of change.
    """
    windows, count = spread.shape
    out = np.zeros((windows, count))
    for w in range(windows):
        for j in range(count):
            c, info = sums[w, j], sums[w, 2 * count + j]
            # No spread: the offset is known exactly and takes nothing off.
            if spread[w, j] > 0.0:
                shared = sums[w, 3 * count + j] / (sums[w, 4 * count + j] + 1.0 / spread[w, j])
                c -= shared * sums[w, count + j]
                info -= shared * sums[w, 3 * count + j]
            # A window without information has no ratio.
            if info > 1e-9:
                out[w, j] = c * c / (info * (1.0 + slope * info))
    return out


@compiled
def acceleration_statistics(sums: Vector, prior: float) -> Vector:
    """Likelihood ratios (w,) of a constant acceleration error, three components.

    `prior` is the variance of a healthy IMU's error beyond its noise model.
    """
    count = (sums.shape[1] - 12) // 5
    out = np.zeros(sums.shape[0])
    c, info, covariance = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for w in range(sums.shape[0]):
        for a in range(3):
            c[a] = sums[w, 5 * count + a]
            for b in range(3):
                info[a, b] = sums[w, 5 * count + 3 + 3 * a + b]
        for a in range(3):
            for b in range(3):
                # info^2: the prior's share of J, as k J^2 of a ramp.
                squared = (
                    info[a, 0] * info[0, b] + info[a, 1] * info[1, b] + info[a, 2] * info[2, b]
                )
                covariance[a, b] = info[a, b] + prior * squared
            # Keeps the matrix invertible along an axis without information.
            covariance[a, a] += 1e-9
        if info[0, 0] + info[1, 1] + info[2, 2] > 1e-6:
            out[w] = max(cholesky_reduction(covariance, c), 0.0)
    return out
