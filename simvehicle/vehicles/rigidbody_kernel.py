"""Motion of a rigid body with a plane of symmetry, as scalar compiled functions.

State, in this order everywhere: position north, east, down [m]; velocity over ground in body axes
u, v, w [m/s]; unit quaternion body to NED e0, e1, e2, e3 (scalar first); body rates p, q, r
[rad/s]. Equations: Beard and McLain, Small Unmanned Aircraft, 2012, chapter 3 (quaternion form:
appendix B). Everything is branch-free, so a caller's loop over vehicles can be vectorised.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.polynomial import fma
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body, to_ned

State13 = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float, float
]
(NORTH, EAST, DOWN, U, V, W, E0, E1, E2, E3, P, Q, R) = range(13)  # indices of a state array
RIGID_SIZE = 13  # number of states
Loads = tuple[float, float, float, float, float, float]
"""Force [N] and moment about the centre of mass [N m], without gravity, body axes."""


class Inertia(NamedTuple):
    """Mass and the coefficients gamma 1 to 8 of Beard and McLain, equation 3.13."""

    mass_kg: float
    g1: float
    g2: float
    g3: float
    g4: float
    g5: float
    g6: float
    g7: float
    g8: float
    inverse_jy: float


def inertia_coefficients(mass_kg: float, jx: float, jy: float, jz: float, jxz: float) -> Inertia:
    """Coefficients from mass [kg] and moments of inertia [kg m^2] about the centre of mass.

    Raises
    ------
    ValueError
        If the mass or a moment is not positive, or the triangle inequality is violated.
    """
    det = jx * jz - jxz * jxz
    # With a product of inertia, only the principal moments show whether the body is possible.
    principal = np.linalg.eigvalsh([[jx, 0.0, -jxz], [0.0, jy, 0.0], [-jxz, 0.0, jz]])
    if mass_kg <= 0.0 or principal[0] <= 0.0 or principal[0] + principal[1] < principal[2]:
        raise ValueError(
            f"mass {mass_kg} kg with jx {jx}, jy {jy}, jz {jz}, jxz {jxz} kg m^2 is no rigid body; "
            "make all positive and no principal moment larger than the sum of the other two"
        )
    return Inertia(
        mass_kg,
        jxz * (jx - jy + jz) / det,
        (jz * (jz - jy) + jxz * jxz) / det,
        jz / det,
        jxz / det,
        (jz - jx) / jy,
        jxz / jy,
        ((jx - jy) * jx + jxz * jxz) / det,
        jx / det,
        1.0 / jy,
    )


@inlined
def rigid_body_derivative(
    state: State13,
    force: tuple[float, float, float],
    moment: tuple[float, float, float],
    gravity: tuple[float, float, float],
    body: Inertia,
) -> State13:
    """Time derivative of the state.

    Parameters
    ----------
    state : 13 floats
        As in the module docstring.
    force, moment : 3 floats
        Without gravity, about the centre of mass, body axes [N, N m].
    gravity : 3 floats
        Acceleration, NED [m/s^2].
    body : Inertia
    """
    _, _, _, u, v, w, e0, e1, e2, e3, p, q, r = state
    fx, fy, fz = force
    mx, my, mz = moment
    gn, ge, gd = gravity
    gx, gy, gz = to_body(e0, e1, e2, e3, gn, ge, gd)
    vn, ve, vd = to_ned(e0, e1, e2, e3, u, v, w)
    # One division instead of three.
    im = 1.0 / body.mass_kg
    return (
        vn,
        ve,
        vd,
        # Coriolis terms, gravity in body axes and the force: equation 3.15.
        r * v - q * w + gx + fx * im,
        p * w - r * u + gy + fy * im,
        q * u - p * v + gz + fz * im,
        0.5 * (-p * e1 - q * e2 - r * e3),
        0.5 * (p * e0 + r * e2 - q * e3),
        0.5 * (q * e0 - r * e1 + p * e3),
        0.5 * (r * e0 + q * e1 - p * e2),
        # Equations 3.17; Jxz couples roll and yaw.
        body.g1 * p * q - body.g2 * q * r + body.g3 * mx + body.g4 * mz,
        body.g5 * p * r - body.g6 * (p * p - r * r) + body.inverse_jy * my,
        body.g7 * p * q - body.g1 * q * r + body.g4 * mx + body.g8 * mz,
    )


@inlined
def euler_step(state: State13, rate: State13, dt: float) -> State13:
    """State + dt * rate, without normalising the quaternion."""
    # Unrolled, as a loop over a tuple would prevent vectorisation by LLVM.
    north, east, down, u, v, w, e0, e1, e2, e3, p, q, r = state
    dn, de, dd, du, dv, dw, de0, de1, de2, de3, dp, dq, dr = rate
    return (
        fma(dt, dn, north),
        fma(dt, de, east),
        fma(dt, dd, down),
        fma(dt, du, u),
        fma(dt, dv, v),
        fma(dt, dw, w),
        fma(dt, de0, e0),
        fma(dt, de1, e1),
        fma(dt, de2, e2),
        fma(dt, de3, e3),
        fma(dt, dp, p),
        fma(dt, dq, q),
        fma(dt, dr, r),
    )


@inlined
def normalise_quaternion(state: State13) -> State13:
    """The state with its quaternion normalised to length one."""
    north, east, down, u, v, w, e0, e1, e2, e3, p, q, r = state
    inv = 1.0 / np.sqrt(e0 * e0 + e1 * e1 + e2 * e2 + e3 * e3)
    return north, east, down, u, v, w, e0 * inv, e1 * inv, e2 * inv, e3 * inv, p, q, r


@inlined
def runge_kutta_step(
    state: State13,
    loads: Callable[..., Loads],
    given: Any,
    gravity: tuple[float, float, float],
    body: Inertia,
    dt: float,
) -> State13:
    """One classical Runge-Kutta step of a single vehicle.

    The stages are a loop, as four copies of a vehicle's loads take four times as long to compile.

    Parameters
    ----------
    loads : inlined function of (state, stage, given)
        Force [N] and moment [N m] without gravity, body axes, at one of the stages 0 to 3.
    given
        Further inputs of `loads`.
    gravity : 3 floats
        Acceleration, NED [m/s^2].
    """
    # `total` accumulates the weighted rates, `at` is the state of the next stage.
    total = at = state
    for stage in range(4):
        fx, fy, fz, mx, my, mz = loads(at, stage, given)
        rate = rigid_body_derivative(at, (fx, fy, fz), (mx, my, mz), gravity, body)
        total = euler_step(total, rate, dt / (6.0 if stage == 0 or stage == 3 else 3.0))
        at = euler_step(state, rate, dt if stage == 2 else 0.5 * dt)
    return normalise_quaternion(total)
