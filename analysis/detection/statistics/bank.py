"""The bank of leave-out tests as algebra on one inverse (docs/fdi.md, "The main test").

With M the inverse covariance of the innovations v (or, for a snapshot, the weight matrix projected
off the unknowns), u = M v and q = v' M v.
"""

import math

import numpy as np

from analysis.samples.block import Indices
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import invert_positive_definite


@compiled
def cholesky_reduction(block: Vector, right: Vector) -> float:
    """right' inv(block) right of block (k, k) and right (k,) by Cholesky, in place; -1 where the
    block is singular."""
    k = right.shape[0]
    total = 0.0
    for i in range(k):
        pivot = block[i, i]
        for j in range(i):
            pivot -= block[i, j] * block[i, j]
        # Relative to the element: a smaller pivot is only rounding.
        if pivot <= 1e-9 * block[i, i] or block[i, i] <= 0.0:
            return -1.0
        root = math.sqrt(pivot)
        value = right[i]
        for j in range(i):
            value -= block[i, j] * right[j]
        right[i] = value / root
        total += right[i] * right[i]
        for row in range(i + 1, k):
            value = block[row, i]
            for j in range(i):
                value -= block[row, j] * block[i, j]
            block[row, i] = value / root
        block[i, i] = root
    return total


@compiled
def best_subset(m: Vector, u: Vector, q: float, size: int) -> tuple[float, Indices]:
    """The set of `size` measurements whose leaving out lowers the statistic most.

    Parameters
    ----------
    m : (n, n), inverse covariance or projected weights
    u : (n,), m @ v
    q : statistic with all measurements
    size : how many to leave out, at least 1

    Returns
    -------
    statistic without them, and their indices (size,) as an integer array.
    """
    n = u.shape[0]
    pick = np.arange(size)
    best, best_pick = q, pick.copy()
    block, right = np.empty((size, size)), np.empty(size)
    while True:
        for i in range(size):
            right[i] = u[pick[i]]
            for j in range(size):
                block[i, j] = m[pick[i], pick[j]]
        remaining = q - cholesky_reduction(block, right)
        if remaining < best:
            best = remaining
            for i in range(size):
                best_pick[i] = pick[i]
        at = size - 1
        # The next combination in lexical order.
        while at >= 0 and pick[at] == n - size + at:
            at -= 1
        if at < 0:
            return best, best_pick
        pick[at] += 1
        for j in range(at + 1, size):
            pick[j] = pick[j - 1] + 1


def freed_statistic(m: Vector, u: Vector, q: float, g: Vector) -> float:
    """The statistic with the parameters along the columns of g (n, k) freed; q if not separable."""
    lowered = cholesky_reduction(np.ascontiguousarray(g.T @ m @ g), g.T @ u)
    # Parameters that cannot be separated explain nothing: the statistic stays.
    return q - lowered if lowered >= 0.0 else q


def projected_weights(design: Vector, weight: Vector) -> Vector:
    """W - W A inv(A'WA) A'W (n, n) for the geometry A (n, k) and weights (n,): the parity test."""
    weighted = design.T * weight
    cofactor = invert_positive_definite(weighted @ design)
    return np.diag(weight) - weighted.T @ cofactor @ weighted
