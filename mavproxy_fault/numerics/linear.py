"""Small dense linear algebra for the kernels, as plain loops that compile fast."""

import math

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import compiled

Vector = NDArray[np.float64]


@compiled
def multiply_matrices(a: Vector, b: Vector) -> Vector:
    """Return the product a b (n, m) of a (n, k) and b (k, m)."""
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
    """Return a copy (m, n) of the transpose of a (n, m)."""
    out = np.empty((a.shape[1], a.shape[0]))
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[j, i] = a[i, j]
    return out


@compiled
def multiply_vector(a: Vector, v: Vector) -> Vector:
    """Return the product a v (n,) of a (n, k) and v (k,)."""
    out = np.zeros(a.shape[0])
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            out[i] += a[i, j] * v[j]
    return out


@compiled
def cholesky_factor(s: Vector) -> Vector:
    """Return the lower Cholesky factor (n, n) of a matrix; NaN if not positive definite."""
    n = s.shape[0]
    low = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            # Mean of both triangles, since rounding makes a covariance slightly asymmetric.
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
    """Return the inverse of a lower triangular matrix (n, n)."""
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
    """Return the Gram matrix a' a (n, n) of a (m, n)."""
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
    """Invert a positive definite matrix (n, n) by Cholesky; NaN if it is not."""
    return gram_matrix(invert_lower(cholesky_factor(s)))
