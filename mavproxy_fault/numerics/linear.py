"""Small dense linear algebra for the kernels, as plain loops that compile fast."""

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled


@compiled
def multiply_matrices(a: Array, b: Array) -> Array:
    """Return the product a b (n, m) of a (n, k) and b (k, m)."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            factor = a[i, k]
            for j in range(b.shape[1]):
                out[i, j] += factor * b[k, j]
    return out


@compiled
def invert_positive_definite(s: Array) -> Array:
    """Invert a positive definite matrix (n, n) by Gauss-Jordan elimination; NaN if it is not."""
    out = s.copy()
    for k in range(out.shape[0]):
        pivot = out[k, k] if out[k, k] > 0.0 else np.nan
        out[k, k] = 1.0
        for j in range(out.shape[0]):
            out[k, j] /= pivot
        for i in range(out.shape[0]):
            if i != k:
                factor = out[i, k]
                out[i, k] = 0.0
                for j in range(out.shape[0]):
                    out[i, j] -= factor * out[k, j]
    return out
