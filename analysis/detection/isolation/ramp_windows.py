"""Tests with memory: ramps that the filter follows, and so hides, epoch by epoch.

A fault of one satellite that grows since t_0 adds r (t - t_0) to its range. What that does to the
filter is linear: with D the response of the estimated state, of every innovation g = e s - H D, and

    D <- Phi D,  then  D <- D + K g,

so c = sum g' M v and J = sum g' M g over the epochs since t_0 (M the inverse innovation covariance)
give the fault's likeliest slope c / J and the likelihood ratio c^2 / J, chi-square(1) without a
fault [1]_. This equals a bank of sub-filters of their own memory, each with one satellite's fault
set free since t_0, without running them. Several windows start `STRIDE_S` apart.

The innovations of a healthy satellite have an offset that stays for minutes (multipath, ephemeris,
atmosphere). Each satellite's is learnt as a first-order Gauss-Markov process, mean o and variance
B, and what was known of it when a window started is taken off: with v - o in place of v and what is
left of the offset marginalised,

    J = J_rr - J_ro^2 / (J_oo + 1/B),   c = c_r - J_ro c_o / (J_oo + 1/B),

and a natural slope of variance k makes the test c^2 / (J + k J^2). A faulty accelerometer or a
wrong attitude shows as a constant acceleration: three more responses, the rival explanation.

The innovations are never formed: with N, b and P+ of `information`, D_c the response of the states
that are seen and gamma = A' inv(R) g = A' inv(R) e s - N D_c,

    K g = P+_:c gamma,
    g' M v = g' inv(R) v - gamma' P+_c b,   g' M g = g' inv(R) g - gamma' P+_c gamma.

References
----------
.. [1] A. S. Willsky and H. L. Jones, IEEE Trans. Automatic Control 21(1), 1976.
"""

import math

import numpy as np

from analysis.detection.filter.information import Indices, quadratic_of
from analysis.detection.isolation.bank import reduction
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import add_product, apply, multiply

WINDOWS = 4
STRIDE_S = 5.0
YOUNGEST_S = 0.5  # a younger window says nothing that the main test does not
NEWS_S = 1.0  # epochs closer than this tell little new of an offset


@compiled
def respond(
    d: Vector,
    sums: Vector,
    offsets: Vector,
    ages: Vector,
    phi: Vector,
    after: Vector,
    states: Indices,
    a: Vector,
    information: Vector,
    variance: Vector,
    v: Vector,
    dt: float,
) -> tuple[Vector, Vector]:
    """One epoch of ranges more in every window: d and sums after it, as new arrays.

    Parameters
    ----------
    d : (k, w s), responses of the state (k) in each of w windows to s = n + 3 signatures: ramps of
        n satellites, then accelerations along x, y, z
    sums : (w, 5 n + 12): c_r, c_o, J_rr, J_ro, J_oo, then c and J (3, 3) of the accelerations
    offsets : (w, n), what was known of each satellite's offset when the window started
    ages : (w,), seconds since each window's start
    phi, after : transition since the last epoch (k, k), and of the covariance after this one the
        columns (k, c) of the states that are seen
    states, a, information, variance, v : which states are seen (c,), geometry over these (n, c), N
        (c, c), variance and innovations (n,)
    dt : seconds since the last epoch
    """
    windows, count = offsets.shape
    each = count + 3
    response = multiply(phi, d)
    for w in range(windows):
        for axis in range(3):
            at = w * each + count + axis
            response[axis, at] += 0.5 * dt * dt
            if d.shape[0] > 6:
                response[3 + axis, at] += dt
    sums, known = sums.copy(), _rows(after, states)
    seen, gamma = _seen(response, states, information)
    own, left = np.empty(count), np.empty(count)
    for i in range(count):
        own[i] = (1.0 - quadratic_of(a, i, known) / variance[i]) / variance[i]
        for k in range(states.shape[0]):
            share = a[i, k] / variance[i]
            for w in range(windows):
                gamma[k, w * each + i] += share * ages[w]
    whole = _whole(seen, gamma, known)
    for w in range(windows):
        b = np.zeros(states.shape[0])
        for i in range(count):
            left[i] = (v[i] - offsets[w, i]) / variance[i]
            sums[w, 4 * count + i] += own[i]
            for k in range(b.shape[0]):
                b[k] += a[i, k] * left[i]
        moved = apply(known, b)
        first = w * each
        _add_ramps(sums[w], seen, gamma, whole, first, a, variance, left, ages[w], b, moved)
        _add_accelerations(sums[w], seen, gamma, whole, first + count, b, moved)
    add_product(response, 1.0, after, gamma)
    return response, sums


@compiled
def _rows(m: Vector, which: Indices) -> Vector:
    """Some rows of a matrix."""
    out = np.empty((which.shape[0], m.shape[1]))
    for i in range(which.shape[0]):
        for j in range(m.shape[1]):
            out[i, j] = m[which[i], j]
    return out


@compiled
def _seen(response: Vector, states: Indices, information: Vector) -> tuple[Vector, Vector]:
    """D_c and -N D_c (c, w s)."""
    seen = _rows(response, states)
    gamma = np.zeros_like(seen)
    add_product(gamma, -1.0, information, seen)
    return seen, gamma


@compiled
def _whole(seen: Vector, gamma: Vector, known: Vector) -> Vector:
    """D_c + P+_c gamma (c, w s)."""
    whole = multiply(known, gamma)
    for k in range(seen.shape[0]):
        for j in range(seen.shape[1]):
            whole[k, j] += seen[k, j]
    return whole


@compiled
def _add_ramps(
    row: Vector,
    seen: Vector,
    gamma: Vector,
    whole: Vector,
    first: int,
    a: Vector,
    variance: Vector,
    left: Vector,
    age: float,
    b: Vector,
    moved: Vector,
) -> None:
    """Add an epoch to a window's sums of ramps and c_o, in place; its ramps are the columns from
    `first`, `left` (n,) the innovations over their variance."""
    count = left.shape[0]
    for i in range(count):
        followed = mixed = cross = told = offset = 0.0
        for k in range(b.shape[0]):
            response, own, both = seen[k, first + i], gamma[k, first + i], whole[k, first + i]
            followed += a[i, k] * response
            mixed += a[i, k] * both
            cross += own * both
            told += response * b[k] + own * moved[k]
            offset += a[i, k] * moved[k]
        row[i] += age * left[i] - told
        row[count + i] += left[i] - offset / variance[i]
        row[2 * count + i] += age * (age - followed) / variance[i] - cross
        row[3 * count + i] += (age - mixed) / variance[i]


@compiled
def _add_accelerations(
    row: Vector,
    seen: Vector,
    gamma: Vector,
    whole: Vector,
    first: int,
    b: Vector,
    moved: Vector,
) -> None:
    """Add to c and J of the accelerations, the last 12 of `row`, in place; theirs are the columns
    from `first`, `whole` is D_c + P+_c gamma."""
    to = row.shape[0] - 12
    for k in range(b.shape[0]):
        for i in range(3):
            row[to + i] -= seen[k, first + i] * b[k] + gamma[k, first + i] * moved[k]
            for j in range(3):
                row[to + 3 + 3 * i + j] -= whole[k, first + i] * gamma[k, first + j]


@compiled
def respond_to_rates(
    d: Vector, sums: Vector, after: Vector, states: Indices, information: Vector, b: Vector
) -> None:
    """The same for Doppler rates of information N and b, which no fault of a range touches:
    accelerations alone gain. d and sums change in place."""
    count = (sums.shape[1] - 12) // 5
    known = _rows(after, states)
    seen, gamma = _seen(d, states, information)
    whole, moved = _whole(seen, gamma, known), apply(known, b)
    for w in range(sums.shape[0]):
        _add_accelerations(sums[w], seen, gamma, whole, w * (count + 3) + count, b, moved)
    add_product(d, 1.0, after, gamma)


@compiled
def learn_offsets(
    offset: Vector,
    spread: Vector,
    prior: Vector,
    a: Vector,
    variance: Vector,
    v: Vector,
    dt_s: float,
    numbers: Vector,
) -> tuple[Vector, Vector]:
    """Mean and variance (n,) of each satellite's offset after the innovations v of one epoch.

    `prior` (c, c) is the covariance of the states that are seen, by the geometry a (n, c), before
    it. `numbers` are those of `DetectorConfig.memory_numbers`; an epoch `dt_s` after the last tells
    min(dt_s, 1 s) of what an independent one would.
    """
    slow, stays, news = numbers[0], math.exp(-dt_s / numbers[1]), min(dt_s / NEWS_S, 1.0)
    mean, wide = offset.copy(), spread.copy()
    for i in range(mean.shape[0]):
        mean[i] *= stays
        wide[i] = stays * stays * wide[i] + (1.0 - stays * stays) * slow * variance[i]
        s = variance[i] + quadratic_of(a, i, prior)
        share = wide[i] / (wide[i] + s / news)
        mean[i] += share * (v[i] - mean[i])
        wide[i] *= 1.0 - share
    return mean, wide


@compiled
def strongest(
    sums: Vector, spreads: Vector, ages: Vector, inertial: bool, numbers: Vector
) -> tuple[float, int, int, float]:
    """The largest ratio of a ramp with its window and satellite (-1: none is old enough), and the
    largest of the rival, an acceleration error, where an IMU is used."""
    best, window, worst, rival = 0.0, -1, -1, 0.0
    ramps = ramp_statistics(sums, spreads, numbers[2])
    wrong = acceleration_statistics(sums, numbers[3]) if inertial else np.zeros(ages.shape[0])
    for w in range(ages.shape[0]):
        if ages[w] >= YOUNGEST_S:
            rival = max(rival, wrong[w])
            for j in range(ramps.shape[1]):
                if ramps[w, j] > best or worst < 0:
                    best, window, worst = ramps[w, j], w, j
    return best, window, worst, rival


@compiled
def ramp_statistics(sums: Vector, spread: Vector, slope: float) -> Vector:
    """Likelihood ratios (w, n) of a ramp on each satellite.

    `spread` (w, n) is the variance of what a window does not know of a healthy satellite's offset,
    `slope` that of its natural rate of change.
    """
    windows, count = spread.shape
    out = np.zeros((windows, count))
    for w in range(windows):
        for j in range(count):
            c, info = sums[w, j], sums[w, 2 * count + j]
            if spread[w, j] > 0.0:
                shared = sums[w, 3 * count + j] / (sums[w, 4 * count + j] + 1.0 / spread[w, j])
                c -= shared * sums[w, count + j]
                info -= shared * sums[w, 3 * count + j]
            if info > 1e-9:
                out[w, j] = c * c / (info * (1.0 + slope * info))
    return out


@compiled
def acceleration_statistics(sums: Vector, prior: float) -> Vector:
    """Likelihood ratios (w,) of a constant acceleration error, three components.

    `prior` is the variance of what a sound IMU may be wrong by beyond its noise model.
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
                squared = (
                    info[a, 0] * info[0, b] + info[a, 1] * info[1, b] + info[a, 2] * info[2, b]
                )
                covariance[a, b] = info[a, b] + prior * squared
            covariance[a, a] += 1e-9
        if info[0, 0] + info[1, 1] + info[2, 2] > 1e-6:
            out[w] = max(reduction(covariance, c), 0.0)
    return out
