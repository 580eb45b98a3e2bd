"""Contact with level ground: springs, dampers and friction at points of the body.

A spring with a damper pushes a point below the ground up, and Coulomb friction opposes its motion.
Around zero speed the friction is smoothed over `_CREEP_MPS`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body, to_ned
from simvehicle.vehicles.rigidbody_kernel import State13

_CREEP_MPS = 0.05  # chosen: keeps the friction smooth enough for steps of 5 ms


class Gear(NamedTuple):
    """Contact points (n, 3) in body axes [m], and the constants of each point.

    Stiffness [N/m], damping [N s/m], friction coefficients along and across the body x axis.
    """

    points_m: NDArray[np.float64]
    stiffness: float
    damping: float
    along: float
    across: float


def make_gear(points_m: NDArray[np.float64], mass_kg: float, along: float, across: float) -> Gear:
    """Gear with a natural frequency of 40 rad/s and 0.7 of critical damping (6 mm static sag).

    `points_m` (n, 3) are the contact points in body axes.
    """
    # Each point carries an equal share of the mass.
    each = mass_kg / len(points_m)
    return Gear(points_m, each * 40.0**2, each * 2.0 * 0.7 * 40.0, along, across)


@inlined
def contact_loads(
    state: State13, ground_down_m: float, wheels: Gear
) -> tuple[float, float, float, float, float, float]:
    """Force [N] and moment [N m] of the ground on the body, in body axes.

    `ground_down_m` is the ground's down coordinate in the frame of the state's position.
    """
    _, _, down, u, v, w, e0, e1, e2, e3, p, q, r = state
    fx = fy = fz = mx = my = mz = 0.0
    for i in range(wheels.points_m.shape[0]):
        x, y, z = wheels.points_m[i, 0], wheels.points_m[i, 1], wheels.points_m[i, 2]
        depth = down + to_ned(e0, e1, e2, e3, x, y, z)[2] - ground_down_m
        vx = u + q * z - r * y
        vy = v + r * x - p * z
        vz = w + p * y - q * x
        vn, ve, vd = to_ned(e0, e1, e2, e3, vx, vy, vz)
        normal = wheels.stiffness * depth + wheels.damping * vd
        # The ground never pulls, even if the damper would.
        normal = normal if depth > 0.0 and normal > 0.0 else 0.0
        # Split the horizontal velocity along and across the heading.
        cn, ce, _ = to_ned(e0, e1, e2, e3, 1.0, 0.0, 0.0)
        length = np.sqrt(cn * cn + ce * ce) + 1e-9
        cn, ce = cn / length, ce / length
        ahead = vn * cn + ve * ce
        aside = -vn * ce + ve * cn
        # The creep speed keeps the friction continuous at rest.
        slip = np.sqrt(ahead * ahead + aside * aside) + _CREEP_MPS
        friction_along = -wheels.along * normal * ahead / slip
        friction_across = -wheels.across * normal * aside / slip
        gx, gy, gz = to_body(
            e0,
            e1,
            e2,
            e3,
            friction_along * cn - friction_across * ce,
            friction_along * ce + friction_across * cn,
            -normal,
        )
        fx += gx
        fy += gy
        fz += gz
        mx += y * gz - z * gy
        my += z * gx - x * gz
        mz += x * gy - y * gx
    return fx, fy, fz, mx, my, mz
