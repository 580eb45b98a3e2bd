"""The arithmetic of other sensors' tests, compiled: see `reference` and `reference_models`."""

import numpy as np

from analysis.fdi.inertial import matrix
from analysis.fdi.linear import add_product, apply, inverse, multiply, transposed
from analysis.gnss import geodetic, ned_axes
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled


@compiled
def _in_axes(axes: Vector, p: Vector, at: int) -> Vector:
    """The covariance (3, 3) of three errors from `at` on, turned into the axes."""
    part = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            part[i, j] = p[at + i, at + j]
    return multiply(multiply(axes, part), transposed(axes))


@compiled
def local(
    x: Vector, p: Vector
) -> tuple[float, float, Vector, Vector, Vector, tuple[Vector, Vector, Vector]]:
    """The filter's state x (19,) and covariance p (18, 18) in local terms.

    Returns
    -------
    Latitude, height, axes NED in ECEF (3, 3), velocity NED (3,), rotation body to NED (3, 3), and
    the covariances (3, 3) of position, velocity and attitude in NED.
    """
    lat, lon, height = geodetic(x[0:3])
    axes = ned_axes(lat, lon)
    v_ned = apply(axes, x[3:6])
    rot_nb = multiply(axes, matrix(x[6:10]))
    parts = (_in_axes(axes, p, 0), _in_axes(axes, p, 3), _in_axes(axes, p, 6))
    return lat, height, axes, v_ned, rot_nb, parts


@compiled
def test(
    v: Vector, h: Vector, r: Vector, b: Vector, p: Vector, walk: Vector, dt_s: float
) -> tuple[float, Vector, Vector]:
    """The statistic of an innovation v (m,), and the slow states after it.

    Parameters
    ----------
    h, r : (m, k), (m, m)
        Sensitivity of v to the slow states, and the rest of its variance.
    b, p, walk : (k,), (k, k), (k,)
        Slow states, their covariance, and their variance per second.
    dt_s : float
        How old the slow states are.

    Returns
    -------
    v' inv(h p h' + r) v, b and p.
    """
    p = p.copy()
    for i in range(len(b)):
        p[i, i] += walk[i] * max(dt_s, 0.0)
    ph = multiply(p, transposed(h))
    s = multiply(h, ph)
    for i in range(len(v)):
        for j in range(len(v)):
            s[i, j] += r[i, j]
    inv = inverse(s)
    u = apply(inv, v)
    q = 0.0
    for i in range(len(v)):
        q += v[i] * u[i]
    gain = multiply(ph, inv)
    b = b + apply(gain, v)
    add_product(p, -1.0, gain, transposed(ph))
    return q, b, p
