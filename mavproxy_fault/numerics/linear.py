"""Small dense linear algebra for the kernels: plain loops, which compile fast and stay in cache."""

import math

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import compiled

Vector = NDArray[np.float64]


@compiled
def multiply_matrices(a: Vector, b: Vector) -> Vector:
    """a b (n, m) of a (n, k) and b (k, m)."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            factor = a[i, k]
            if factor != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += factor * b[k, j]
    return out


@compiled
def add_product(out: Vector, scale: float, a: Vector, b: Vector) -> None:
    """Add scale a b to `out` (n, m), in place; a (n, k), b (k, m)."""
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            factor = scale * a[i, k]
            for j in range(b.shape[1]):
                out[i, j] += factor * b[k, j]


@compiled
def transpose_matrix(a: Vector) -> Vector:
    """a' (m, n) as an array of its own."""
    out = np.empty((a.shape[1], a.shape[0]))
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[j, i] = a[i, j]
    return out


@compiled
def multiply_vector(a: Vector, v: Vector) -> Vector:
    """a v (n,) of a (n, k) and v (k,)."""
    out = np.zeros(a.shape[0])
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i] += a[i, j] * v[j]
    return out


@compiled
def cholesky_factor(s: Vector) -> Vector:
    """Cholesky's lower triangle of a positive definite matrix (n, n); NaN where it is not."""
    n = s.shape[0]
    low = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            # Rounding leaves a covariance a little asymmetric: the mean of both halves counts.
            total = 0.5 * (s[i, j] + s[j, i])
            for k in range(j):
                total -= low[i, k] * low[j, k]
            if i == j:
                low[i, i] = math.sqrt(total) if total > 0.0 else np.nan
            else:
                low[i, j] = total / low[j, j]
    return low


@compiled
def invert_lower(low: Vector) -> Vector:
    """The inverse of a lower triangle (n, n)."""
    n = low.shape[0]
    root = np.zeros((n, n))
    for i in range(n):
        root[i, i] = 1.0 / low[i, i]
        for k in range(i):
            factor = low[i, k]
            for j in range(k + 1):
                root[i, j] -= factor * root[k, j]
        for j in range(i):
            root[i, j] *= root[i, i]
    return root


@compiled
def gram_matrix(a: Vector) -> Vector:
    """a' a (n, n)."""
    n = a.shape[1]
    out = np.zeros((n, n))
    for k in range(a.shape[0]):
        for i in range(n):
            factor = a[k, i]
            if factor != 0.0:
                for j in range(n):
                    out[i, j] += factor * a[k, j]
    return out


@compiled
def invert_positive_definite(s: Vector) -> Vector:
    """The inverse of a positive definite matrix (n, n), by Cholesky; NaN where it is not."""
    return gram_matrix(invert_lower(cholesky_factor(s)))
