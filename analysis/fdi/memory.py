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

References
----------
.. [1] A. S. Willsky and H. L. Jones, IEEE Trans. Automatic Control 21(1), 1976.
"""

import math

import numpy as np

from analysis.fdi.bank import reduction
from analysis.fdi.linear import add_product, apply, multiply
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled

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
    gain: Vector,
    m: Vector,
    h: Vector,
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
    phi, gain, m, h, v : transition since the last epoch (k, k), gain (k, n), inverse innovation
        covariance (n, n), geometry (n, k) and innovations (n,)
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
    g = multiply(h, response)
    for i in range(g.shape[0]):
        for j in range(g.shape[1]):
            g[i, j] = -g[i, j]
        for w in range(windows):
            g[i, w * each + i] += ages[w]
    mg = multiply(m, g)
    sums = sums.copy()
    left = np.empty(count)
    for w in range(windows):
        for i in range(count):
            left[i] = v[i] - offsets[w, i]
        mv = apply(m, left)
        for i in range(count):
            sums[w, count + i] += mv[i]
            sums[w, 3 * count + i] += mg[i, w * each + i]
            sums[w, 4 * count + i] += m[i, i]
            for j in range(count):
                ramp = g[i, w * each + j]
                sums[w, j] += ramp * mv[i]
                sums[w, 2 * count + j] += ramp * mg[i, w * each + j]
        _add_accelerations(sums[w], 5 * count, g, mg, mv, w * each + count)
    add_product(response, 1.0, gain, g)
    return response, sums


@compiled
def _add_accelerations(
    row: Vector, first: int, g: Vector, mg: Vector, mv: Vector, column: int
) -> None:
    """Add to c and J of the accelerations, in place: `row` from `first`, `g` from `column`."""
    for i in range(g.shape[0]):
        for a in range(3):
            row[first + a] += g[i, column + a] * mv[i]
            for b in range(3):
                row[first + 3 + 3 * a + b] += g[i, column + a] * mg[i, column + b]


@compiled
def respond_to_rates(
    d: Vector, sums: Vector, gain: Vector, m: Vector, h: Vector, v: Vector
) -> tuple[Vector, Vector]:
    """The same for Doppler rates, which no fault of a range touches: accelerations alone gain."""
    count = (sums.shape[1] - 12) // 5
    g = multiply(h, d)
    for i in range(g.shape[0]):
        for j in range(g.shape[1]):
            g[i, j] = -g[i, j]
    sums, d = sums.copy(), d.copy()
    own = np.empty((g.shape[0], 3 * sums.shape[0]))
    for i in range(g.shape[0]):
        for w in range(sums.shape[0]):
            for a in range(3):
                own[i, 3 * w + a] = g[i, w * (count + 3) + count + a]
    mv, mg = apply(m, v), multiply(m, own)
    for w in range(sums.shape[0]):
        _add_accelerations(sums[w], 5 * count, own, mg, mv, 3 * w)
    add_product(d, 1.0, gain, g)
    return d, sums


@compiled
def learn_offsets(
    offset: Vector,
    spread: Vector,
    p: Vector,
    h: Vector,
    variance: Vector,
    v: Vector,
    dt_s: float,
    numbers: Vector,
) -> tuple[Vector, Vector]:
    """Mean and variance (n,) of each satellite's offset after the innovations v of one epoch.

    `numbers` are those of `DetectorConfig.memory_numbers`; an epoch `dt_s` after the last tells
    min(dt_s, 1 s) of what an independent one would.
    """
    slow, stays, news = numbers[0], math.exp(-dt_s / numbers[1]), min(dt_s / NEWS_S, 1.0)
    mean, wide = offset.copy(), spread.copy()
    for i in range(mean.shape[0]):
        mean[i] *= stays
        wide[i] = stays * stays * wide[i] + (1.0 - stays * stays) * slow * variance[i]
        s = variance[i]
        for j in range(h.shape[1]):
            if h[i, j] != 0.0:
                for k in range(h.shape[1]):
                    s += h[i, j] * p[j, k] * h[i, k]
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
    for w in range(sums.shape[0]):
        c, info, covariance = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
        for a in range(3):
            c[a] = sums[w, 5 * count + a]
            for b in range(3):
                info[a, b] = sums[w, 5 * count + 3 + 3 * a + b]
        squared = multiply(info, info)
        for a in range(3):
            for b in range(3):
                covariance[a, b] = info[a, b] + prior * squared[a, b]
            covariance[a, a] += 1e-9
        if info[0, 0] + info[1, 1] + info[2, 2] > 1e-6:
            out[w] = max(reduction(covariance, c), 0.0)
    return out
