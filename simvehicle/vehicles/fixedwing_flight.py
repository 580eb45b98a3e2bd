"""The fixed wing as the interactive simulator flies it: the kernel with ground and battery.

The state array has 14 entries: the 13 of `rigidbody_kernel` and the charge drawn [A s].
"""

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
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
_BRAKES = 0.4  # friction along the body while the throttle is closed
_BODY = len(Inertia._fields)
_AERO = len(Aero._fields)
_END = _BODY + _AERO


def pack(body: Inertia, aero: Aero, wheels: Gear, shift_x_m: float) -> Array:
    """All parameters of `fly` but the contact points, in one array.

    `shift_x_m` is how far the centre of mass lies ahead of where the coefficients hold.
    """
    return np.array([*body, *aero, *wheels[1:], shift_x_m])


@inlined
def _loads(
    state: State13,
    controls: tuple[float, float, float, float],
    wind: tuple[float, float, float],
    density: float,
    ground_down_m: float,
    aero: Aero,
    wheels: Gear,
    shift: float,
) -> tuple[float, float, float, float, float, float]:
    wx, wy, wz = to_body(state[6], state[7], state[8], state[9], wind[0], wind[1], wind[2])
    air = (state[3] - wx, state[4] - wy, state[5] - wz)
    rates = (state[10], state[11], state[12])
    a = forces_moments(air, rates, controls, density, aero)
    g = contact(state, ground_down_m, wheels)
    return (
        a[0] + g[0],
        a[1] + g[1],
        a[2] + g[2],
        a[3] + g[3],
        a[4] + g[4] + shift * a[2],
        a[5] + g[5] - shift * a[1],
    )


@inlined
def _loaded_step(
    s: State13,
    u: tuple[float, float, float, float],
    wind: tuple[float, float, float],
    gravity: tuple[float, float, float],
    rho: float,
    ground: float,
    body: Inertia,
    aero: Aero,
    wheels: Gear,
    shift: float,
    dt: float,
) -> State13:
    """One Runge-Kutta step with ground contact and a shifted centre of mass."""
    f = _loads(s, u, wind, rho, ground, aero, wheels, shift)
    k1 = rigid_body(s, (f[0], f[1], f[2]), (f[3], f[4], f[5]), gravity, body)
    s2 = moved(s, k1, 0.5 * dt)
    f = _loads(s2, u, wind, rho, ground, aero, wheels, shift)
    k2 = rigid_body(s2, (f[0], f[1], f[2]), (f[3], f[4], f[5]), gravity, body)
    s3 = moved(s, k2, 0.5 * dt)
    f = _loads(s3, u, wind, rho, ground, aero, wheels, shift)
    k3 = rigid_body(s3, (f[0], f[1], f[2]), (f[3], f[4], f[5]), gravity, body)
    s4 = moved(s, k3, dt)
    f = _loads(s4, u, wind, rho, ground, aero, wheels, shift)
    k4 = rigid_body(s4, (f[0], f[1], f[2]), (f[3], f[4], f[5]), gravity, body)
    return runge_kutta(s, k1, k2, k3, k4, dt)


@inlined
def _clipped(value: float, low: float, high: float) -> float:
    return min(high, max(low, value))


@compiled
def fly(
    x: Array,
    controls: Array,
    throw: tuple[float, float, float],
    wind: Array,
    gravity: Array,
    air_ground: tuple[float, float],
    steps: int,
    dt: float,
    packed: Array,
    points_m: Array,
) -> tuple[Array, Array]:
    """Advance the state by `steps` steps of `dt` seconds.

    Parameters
    ----------
    x : array, shape (14,)
    controls : array, shape (4,)
        Elevator, aileron, rudder (-1 to 1 of `throw` [rad]), throttle (0 to 1); clipped.
    wind, gravity : arrays, shape (3,)
        NED [m/s], [m/s^2].
    air_ground : 2 floats
        Air density [kg/m^3] and the ground's down coordinate [m].
    packed : array
        From `pack`; handing numba the named tuples themselves costs some microseconds each.
    points_m : array, shape (n, 3)
        Contact points.

    Returns
    -------
    x : array, shape (14,)
    load : array, shape (4,)
        Specific force in body axes [m/s^2] at the new state, and motor current [A].
    """
    rho, ground = air_ground
    body = Inertia(*to_fixed_tuple(packed[:_BODY], _BODY))
    aero = Aero(*to_fixed_tuple(packed[_BODY:_END], _AERO))
    rolling = packed[_END + 2] if controls[3] > 0.0 else _BRAKES
    wheels = Gear(points_m, packed[_END], packed[_END + 1], rolling, packed[_END + 3])
    shift = packed[_END + 4]
    surfaces = (
        _clipped(controls[0], -1.0, 1.0) * throw[0],
        _clipped(controls[1], -1.0, 1.0) * throw[1],
        _clipped(controls[2], -1.0, 1.0) * throw[2],
        _clipped(controls[3], 0.0, 1.0),
    )
    w = (wind[0], wind[1], wind[2])
    g = (gravity[0], gravity[1], gravity[2])
    s = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12])
    for _ in range(steps):
        if s[2] < ground - _CLEAR_M and shift == 0.0:
            s = step(s, surfaces, w, g, rho, body, aero, dt)
        else:
            s = _loaded_step(s, surfaces, w, g, rho, ground, body, aero, wheels, shift, dt)
    f = _loads(s, surfaces, w, rho, ground, aero, wheels, shift)
    wx, wy, wz = to_body(s[6], s[7], s[8], s[9], w[0], w[1], w[2])
    airspeed = np.sqrt((s[3] - wx) ** 2 + (s[4] - wy) ** 2 + (s[5] - wz) ** 2)
    current = propulsion(airspeed, surfaces[3], rho, aero)[2]
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
