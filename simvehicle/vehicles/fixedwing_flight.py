"""The fixed wing as the interactive simulator flies it: the kernel with ground and battery.

The state array has 14 entries: the 13 of `rigidbody_kernel` and the charge drawn [A s].
"""

import numpy as np
from numpy.typing import NDArray

from simvehicle.compiled import compiled, inlined
from simvehicle.vehicles.contact_kernel import Gear, contact
from simvehicle.vehicles.fixedwing_kernel import Aero, forces_moments, propulsion, step
from simvehicle.vehicles.rigidbody_kernel import (
    Inertia,
    State13,
    moved,
    rigid_body,
    runge_kutta,
    to_body,
)

Array = NDArray[np.float64]
_CLEAR_M = 5.0  # above this height nothing can touch the ground


@inlined
def _loads(
    state: State13,
    controls: tuple[float, float, float, float],
    wind: tuple[float, float, float],
    density: float,
    ground_down_m: float,
    aero: Aero,
    wheels: Gear,
) -> tuple[float, float, float, float, float, float]:
    wx, wy, wz = to_body(state[6], state[7], state[8], state[9], wind[0], wind[1], wind[2])
    air = (state[3] - wx, state[4] - wy, state[5] - wz)
    rates = (state[10], state[11], state[12])
    a = forces_moments(air, rates, controls, density, aero)
    g = contact(state, ground_down_m, wheels)
    return a[0] + g[0], a[1] + g[1], a[2] + g[2], a[3] + g[3], a[4] + g[4], a[5] + g[5]


@inlined
def _near_ground(
    s: State13,
    u: tuple[float, float, float, float],
    wind: tuple[float, float, float],
    gravity: tuple[float, float, float],
    rho: float,
    ground: float,
    body: Inertia,
    aero: Aero,
    wheels: Gear,
    dt: float,
) -> State13:
    """One Runge-Kutta step with ground contact."""
    f = _loads(s, u, wind, rho, ground, aero, wheels)
    k1 = rigid_body(s, (f[0], f[1], f[2]), (f[3], f[4], f[5]), gravity, body)
    s2 = moved(s, k1, 0.5 * dt)
    f = _loads(s2, u, wind, rho, ground, aero, wheels)
    k2 = rigid_body(s2, (f[0], f[1], f[2]), (f[3], f[4], f[5]), gravity, body)
    s3 = moved(s, k2, 0.5 * dt)
    f = _loads(s3, u, wind, rho, ground, aero, wheels)
    k3 = rigid_body(s3, (f[0], f[1], f[2]), (f[3], f[4], f[5]), gravity, body)
    s4 = moved(s, k3, dt)
    f = _loads(s4, u, wind, rho, ground, aero, wheels)
    k4 = rigid_body(s4, (f[0], f[1], f[2]), (f[3], f[4], f[5]), gravity, body)
    return runge_kutta(s, k1, k2, k3, k4, dt)


@compiled
def fly(
    x: Array,
    controls: tuple[float, float, float, float],
    wind: tuple[float, float, float],
    gravity: tuple[float, float, float],
    air_ground: tuple[float, float],
    steps: int,
    dt: float,
    body: Inertia,
    aero: Aero,
    wheels: Gear,
) -> tuple[Array, Array]:
    """Advance the state by `steps` steps of `dt` seconds.

    Parameters
    ----------
    x : array, shape (14,)
    controls : elevator, aileron, rudder [rad], throttle (0 to 1)
    wind, gravity : NED [m/s], [m/s^2]
    air_ground : air density [kg/m^3] and the ground's down coordinate [m]

    Returns
    -------
    x : array, shape (14,)
    load : array, shape (4,)
        Specific force in body axes [m/s^2] at the new state, and motor current [A].
    """
    rho, ground = air_ground
    s = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12])
    for _ in range(steps):
        if s[2] < ground - _CLEAR_M:
            s = step(s, controls, wind, gravity, rho, body, aero, dt)
        else:
            s = _near_ground(s, controls, wind, gravity, rho, ground, body, aero, wheels, dt)
    f = _loads(s, controls, wind, rho, ground, aero, wheels)
    wx, wy, wz = to_body(s[6], s[7], s[8], s[9], wind[0], wind[1], wind[2])
    airspeed = np.sqrt((s[3] - wx) ** 2 + (s[4] - wy) ** 2 + (s[5] - wz) ** 2)
    current = propulsion(airspeed, controls[3], rho, aero)[2]
    out = np.empty(14)
    for i in range(13):
        out[i] = s[i]
    out[13] = x[13] + current * steps * dt
    load = np.empty(4)
    load[0] = f[0] / body.mass_kg
    load[1] = f[1] / body.mass_kg
    load[2] = f[2] / body.mass_kg
    load[3] = current
    return out, load
