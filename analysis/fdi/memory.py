"""Tests with memory: ramps that the filter follows, and so hides, epoch by epoch.

A fault of one satellite since t_0 adds b + r (t - t_0) to its range. What that does to the filter
is linear: with D the response of the estimated state, of every innovation g = e s - H D, and

    D <- Phi D,  then  D <- D + K g,

so c = sum g' M v and J = sum g' M g over the epochs since t_0 (M the inverse innovation covariance)
give the fault's likeliest size c / J and the likelihood ratio c^2 / J, chi-square(1) without a
fault [1]_. This equals a bank of sub-filters of their own memory, each with one satellite's fault
set free since t_0, without running them. Several windows start `STRIDE_S` apart. The slow part of
a healthy satellite's error enters as priors: a bias of variance B is marginalised,

    J = J_rr - J_rb^2 / (J_bb + 1/B),   c = c_r - J_rb c_b / (J_bb + 1/B),

and a natural slope of variance k makes the test c^2 / (J + k J^2). A faulty accelerometer or a
wrong attitude shows as a constant acceleration: three more responses, the rival explanation.

References
----------
.. [1] A. S. Willsky and H. L. Jones, IEEE Trans. Automatic Control 21(1), 1976.
"""

import numpy as np
from numpy.typing import NDArray

from analysis.compiled import compiled
from analysis.fdi.bank import reduction
from analysis.fdi.linear import apply, multiply
from analysis.samples import Vector

Slots = NDArray[np.int64]
WINDOWS = 4
STRIDE_S = 5.0


@compiled
def respond(
    d: Vector,
    sums: Vector,
    ages: Vector,
    phi: Vector,
    gain: Vector,
    m: Vector,
    h: Vector,
    v: Vector,
    slots: Slots,
    dt: float,
) -> tuple[Vector, Vector]:
    """One epoch of ranges more in every window.

    Parameters
    ----------
    d : (k, w s), responses of the state (k) in each of w windows to s = 2 n + 3 signatures: ramps,
        then biases of n satellites, then accelerations along x, y, z
    sums : (w, 5 n + 12): c_r, c_b, J_rr, J_rb, J_bb, then c and J (3, 3) of the accelerations
    ages : (w,), seconds since each window's start
    phi, gain, m, h, v : transition since the last epoch (k, k), gain (k, m), inverse innovation
        covariance (m, m), geometry (m, k) and innovations (m,)
    slots : (m,), which satellite each innovation is of
    dt : seconds since the last epoch

    Returns
    -------
    d and sums after the epoch; the arguments stay as they were.
    """
    windows = sums.shape[0]
    count = (sums.shape[1] - 12) // 5
    each = 2 * count + 3
    response = multiply(phi, d)
    for w in range(windows):
        for axis in range(3):
            at = w * each + 2 * count + axis
            response[axis, at] += 0.5 * dt * dt
            if d.shape[0] > 6:
                response[3 + axis, at] += dt
    g = multiply(h, response)
    for i in range(g.shape[0]):
        for j in range(g.shape[1]):
            g[i, j] = -g[i, j]
        for w in range(windows):
            at = w * each + slots[i]
            g[i, at] += ages[w]
            g[i, at + count] += 1.0
    sums = _summed(sums, g, multiply(m, g), apply(m, v), False)
    return _plus(response, multiply(gain, g)), sums


@compiled
def _plus(a: Vector, b: Vector) -> Vector:
    out = np.empty_like(a)
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i, j] = a[i, j] + b[i, j]
    return out


@compiled
def respond_to_rates(
    d: Vector, sums: Vector, gain: Vector, m: Vector, h: Vector, v: Vector
) -> tuple[Vector, Vector]:
    """The same for Doppler rates, which no fault of a range touches: accelerations alone gain."""
    count = (sums.shape[1] - 12) // 5
    g = multiply(h, d)
    each = 2 * count + 3
    few = np.empty((g.shape[0], 3 * sums.shape[0]))
    for i in range(g.shape[0]):
        for j in range(g.shape[1]):
            g[i, j] = -g[i, j]
        for w in range(sums.shape[0]):
            for a in range(3):
                few[i, 3 * w + a] = g[i, w * each + 2 * count + a]
    sums = _summed(sums, few, multiply(m, few), apply(m, v), True)
    return _plus(d, multiply(gain, g)), sums


@compiled
def _summed(sums: Vector, g: Vector, mg: Vector, mv: Vector, only_accelerations: bool) -> Vector:
    sums = sums.copy()
    count = (sums.shape[1] - 12) // 5
    each = 3 if only_accelerations else 2 * count + 3
    for i in range(g.shape[0]):
        for w in range(sums.shape[0]):
            at = w * each
            if not only_accelerations:
                for j in range(count):
                    ramp, bias = g[i, at + j], g[i, at + count + j]
                    sums[w, j] += ramp * mv[i]
                    sums[w, count + j] += bias * mv[i]
                    sums[w, 2 * count + j] += ramp * mg[i, at + j]
                    sums[w, 3 * count + j] += ramp * mg[i, at + count + j]
                    sums[w, 4 * count + j] += bias * mg[i, at + count + j]
                at += 2 * count
            for a in range(3):
                sums[w, 5 * count + a] += g[i, at + a] * mv[i]
                for b in range(3):
                    sums[w, 5 * count + 3 + 3 * a + b] += g[i, at + a] * mg[i, at + b]
    return sums


@compiled
def ramp_statistics(sums: Vector, bias: Vector, slope: float) -> Vector:
    """Likelihood ratios (w, n) of a ramp on each satellite.

    `bias` (n,) is the variance of what stays the same on a healthy satellite, `slope` that of its
    natural rate of change.
    """
    count = bias.shape[0]
    out = np.zeros((sums.shape[0], count))
    for w in range(sums.shape[0]):
        for j in range(count):
            c, info = sums[w, j], sums[w, 2 * count + j]
            if bias[j] > 0.0:
                shared = sums[w, 3 * count + j] / (sums[w, 4 * count + j] + 1.0 / bias[j])
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
