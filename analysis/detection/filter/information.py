"""Measurement updates by the information on the few states that measurements observe.

Pseudoranges observe position, clock and the systems' offsets, Doppler rates velocity and drift: c
states each, 4 to 7 of 20. With A (n, c) the geometry over these, R the noise (diagonal) and P_c the
covariance of these states,

    N = A' inv(R) A,    b = A' inv(R) v,    P_c = L L',    T = I + L' N L,

    P+_c = L inv(T) L',    P+ = P - P_:c Y P_c:  with  Y = inv(L)' (I - inv(T)) inv(L),
    dx = P+_:c b,          gain K = P+_:c A' inv(R),

and the inverse innovation covariance is M = inv(R) - inv(R) A P+_c A' inv(R), so that

    q = v' M v = v' inv(R) v - b' P+_c b.

All of it is the Kalman update by the matrix inversion lemma [1]_; nothing of size n is inverted. T
is never less than I, so a released state (a large P) costs no digits.

References
----------
.. [1] D. Simon, Optimal State Estimation, 2006, sections 1.1.2 and 6.1.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.filter.inertial import DRIFT, PSI, X_Q, V
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.linear import (
    cholesky_factor,
    gram_matrix,
    invert_lower,
    multiply_matrices,
    multiply_vector,
    transpose_matrix,
)
from mavproxy_fault.numerics.rotations.rotation_kernel import rotate_in_reference

Indices = NDArray[np.int64]
RATE_STATES = np.array([V, V + 1, V + 2, DRIFT])


class NormalEquations(NamedTuple):
    """n measurements as normal equations over the c states that they observe.

    `states` (c,) are those states, `a` (n, c) the geometry over them, `variance` and `v` (n,) noise
    and innovations; `information` (c, c) is N, `b` (c,) is b, and `total` v' inv(R) v.
    """

    states: Indices
    a: Vector
    variance: Vector
    v: Vector
    information: Vector
    b: Vector
    total: float


@compiled
def visible_states(h: Vector) -> Indices:
    """The states (c,) that a geometry h (n, 20) depends on."""
    observed = np.empty(h.shape[1], dtype=np.int64)
    count = 0
    for j in range(h.shape[1]):
        for i in range(h.shape[0]):
            if h[i, j] != 0.0:
                observed[count] = j
                count += 1
                break
    return observed[:count]


@compiled
def select_columns(h: Vector, states: Indices) -> Vector:
    """The columns (n, c) of a matrix."""
    out = np.empty((h.shape[0], states.shape[0]))
    for i in range(h.shape[0]):
        for j in range(states.shape[0]):
            out[i, j] = h[i, states[j]]
    return out


@compiled
def covariance_block(p: Vector, states: Indices) -> Vector:
    """The covariance (c, c) of some states."""
    out = np.empty((states.shape[0], states.shape[0]))
    for i in range(states.shape[0]):
        for j in range(states.shape[0]):
            out[i, j] = p[states[i], states[j]]
    return out


@compiled
def normal_equations(h: Vector, variance: Vector, v: Vector) -> NormalEquations:
    """Normal equations of innovations v (n,) with variance (n,) and geometry h (n, 20), over the
    states that they observe."""
    states = visible_states(h)
    return normal_equations_over(states, select_columns(h, states), variance, v)


@compiled
def normal_equations_over(
    states: Indices, a: Vector, variance: Vector, v: Vector
) -> NormalEquations:
    """Normal equations of innovations with geometry a (n, c) over the states `states` (c,)."""
    count = a.shape[1]
    information, b, total = np.zeros((count, count)), np.zeros(count), 0.0
    for i in range(a.shape[0]):
        total += v[i] * v[i] / variance[i]
        for j in range(count):
            share = a[i, j] / variance[i]
            b[j] += share * v[i]
            for k in range(count):
                information[j, k] += share * a[i, k]
    return NormalEquations(states, a, variance, v, information, b, total)


@compiled
def rate_equations(h: Vector, variance: Vector, v: Vector) -> NormalEquations:
    """The normal equations of the Doppler rates v (n,) that are known; h (n, 20) is the geometry of
    the ranges."""
    count = 0
    a, known_variance, known = np.empty((v.shape[0], 4)), np.empty(v.shape[0]), np.empty(v.shape[0])
    for i in range(v.shape[0]):
        if np.isfinite(v[i]):
            for k in range(3):
                a[count, k] = h[i, k]
            a[count, 3], known_variance[count], known[count] = 1.0, variance[i], v[i]
            count += 1
    # A copy: a global array is a constant of the compiled code and may not be changed.
    return normal_equations_over(
        RATE_STATES.copy(), a[:count], known_variance[:count], known[:count]
    )


@compiled
def posterior_block(prior: Vector, information: Vector) -> tuple[Vector, Vector]:
    """P+_c and Y (c, c) of P_c and N."""
    low = cholesky_factor(prior)
    total = multiply_matrices(transpose_matrix(low), multiply_matrices(information, low))
    # T is never less than I: it can be inverted whatever the measurements.
    for i in range(total.shape[0]):
        total[i, i] += 1.0
    root = invert_lower(cholesky_factor(total))
    after = gram_matrix(multiply_matrices(root, transpose_matrix(low)))
    y = gram_matrix(root)
    for i in range(y.shape[0]):
        for j in range(y.shape[0]):
            y[i, j] = -y[i, j]
        y[i, i] += 1.0
    back = invert_lower(low)
    return after, multiply_matrices(transpose_matrix(back), multiply_matrices(y, back))


@compiled
def quadratic_form(v: Vector, m: Vector) -> float:
    """v' m v of v (n,) and m (n, n)."""
    total = 0.0
    for i in range(v.shape[0]):
        for j in range(v.shape[0]):
            total += v[i] * m[i, j] * v[j]
    return total


@inlined
def row_quadratic_form(a: Vector, row: int, m: Vector) -> float:
    """a_i' m a_i of row i of a (n, c), and m (c, c)."""
    total = 0.0
    for i in range(a.shape[1]):
        for j in range(a.shape[1]):
            total += a[row, i] * m[i, j] * a[row, j]
    return total


@compiled
def innovation_statistic(p: Vector, h: Vector, variance: Vector, v: Vector) -> float:
    """q of innovations v (n,) with variance (n,) and geometry h (n, 20) before the covariance p."""
    normal = normal_equations(h, variance, v)
    return normal_statistic(p, normal)


@compiled
def normal_statistic(p: Vector, normal: NormalEquations) -> float:
    """q of measurements before the covariance p (20, 20)."""
    after = posterior_block(covariance_block(p, normal.states), normal.information)[0]
    return normal.total - quadratic_form(normal.b, after)


@compiled
def inverse_covariance(p: Vector, h: Vector, variance: Vector) -> Vector:
    """The inverse innovation covariance M (n, n)."""
    normal = normal_equations(h, variance, np.zeros(variance.shape[0]))
    after = posterior_block(covariance_block(p, normal.states), normal.information)[0]
    out = multiply_matrices(normal.a, multiply_matrices(after, transpose_matrix(normal.a)))
    for i in range(variance.shape[0]):
        for j in range(variance.shape[0]):
            out[i, j] *= -1.0 / (variance[i] * variance[j])
        out[i, i] += 1.0 / variance[i]
    return out


@compiled
def update_in_place(
    x: Vector, p: Vector, normal: NormalEquations, y: Vector
) -> tuple[Vector, Vector]:
    """Update x (21,) and p (20, 20), in place, with Y (c, c) of `posterior_block`; returns P+_:c
    (20, c) and dx (20,)."""
    states = normal.states
    rows = np.empty((states.shape[0], p.shape[0]))
    for k in range(states.shape[0]):
        for j in range(p.shape[0]):
            rows[k, j] = p[states[k], j]
    weighted = multiply_matrices(y, rows)
    for i in range(p.shape[0]):
        for k in range(states.shape[0]):
            factor = rows[k, i]
            # The lower half alone, then mirrored: half the work, and exactly symmetric.
            for j in range(i + 1):
                p[i, j] -= factor * weighted[k, j]
        for j in range(i):
            p[j, i] = p[i, j]
    after = select_columns(p, states)
    moved = multiply_vector(after, normal.b)
    add_error(x, moved)
    return after, moved


@compiled
def add_error(x: Vector, d: Vector) -> None:
    """Add an error d (20,) to the state x (21,), in place."""
    q = rotate_in_reference(x[X_Q : X_Q + 4], d[PSI], d[PSI + 1], d[PSI + 2])
    for i in range(PSI):
        # The attitude's error rotates the quaternion; everything else adds.
        x[i] += d[i]
    for i in range(4):
        x[X_Q + i] = q[i]
    for i in range(PSI + 3, d.shape[0]):
        # The quaternion has four numbers where its error has three.
        x[1 + i] += d[i]


@compiled
def measurement_update(
    x: Vector, p: Vector, h: Vector, variance: Vector, v: Vector
) -> tuple[Vector, Vector]:
    """State x (21,) and covariance p (20, 20) after measurements with innovations v (n,), their
    variance (n,) and geometry h (n, 20), as new arrays."""
    x, p, normal = x.copy(), p.copy(), normal_equations(h, variance, v)
    update_in_place(
        x, p, normal, posterior_block(covariance_block(p, normal.states), normal.information)[1]
    )
    return x, p
