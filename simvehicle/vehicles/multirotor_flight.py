"""Forces, moments and integration of a multirotor, compiled.

Rotor thrust grows with the square of the motor's speed and with air density; the drag of a rotor's
disc is linear in the speed across its axis (Martin and Salaun, ICRA 2010; the model of the RotorS
simulator, Furrer et al. 2016). Motors follow their commands with first-order lags. The state array
holds the 13 of `rigidbody_kernel`, the motor speeds [rad/s], the current [A] and the charge drawn
[A s].
"""

from typing import NamedTuple

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from simvehicle.compiled import compiled, inlined
from simvehicle.vehicles.contact_kernel import Gear, contact
from simvehicle.vehicles.rigidbody_kernel import (
    Inertia,
    State13,
    moved,
    rigid_body,
    runge_kutta,
    to_body,
)

Array = NDArray[np.float64]
SEA_LEVEL_KGPM3 = 1.225  # density at which thrust coefficients are given


class Airframe(NamedTuple):
    """Coefficients of rotors and body, SI units, and the centre of mass off the rotors' centre."""

    thrust: float
    torque_per_thrust: float
    idle: float
    full: float
    spin_up_s: float
    spin_down_s: float
    rotor_drag: float
    drag_area: float
    damping: float
    shift_x: float
    shift_y: float


_BODY = len(Inertia._fields)
_FRAME = len(Airframe._fields)
_END = _BODY + _FRAME


def pack(body: Inertia, frame: Airframe, wheels: Gear) -> Array:
    """All parameters of `fly` but those with a size of their own, in one array."""
    return np.array([*body, *frame, *wheels[1:]])


@inlined
def loads(
    state: State13,
    speeds: Array,
    rotors: Array,
    wind: tuple[float, float, float],
    density: float,
    ground_down_m: float,
    frame: Airframe,
    wheels: Gear,
) -> tuple[float, float, float, float, float, float]:
    """Force [N] and moment [N m] without gravity about the centre of mass, body axes.

    `rotors` (n, 4 or more) holds x, y [m], the sign of the reaction torque and the propeller's
    efficiency.
    """
    wx, wy, wz = to_body(state[6], state[7], state[8], state[9], wind[0], wind[1], wind[2])
    ax, ay, az = state[3] - wx, state[4] - wy, state[5] - wz
    p, q, r = state[10], state[11], state[12]
    fx = fy = fz = mx = my = mz = 0.0
    for i in range(speeds.shape[0]):
        x, y = rotors[i, 0] - frame.shift_x, rotors[i, 1] - frame.shift_y
        omega = speeds[i]
        thrust = frame.thrust * omega * omega * density / SEA_LEVEL_KGPM3
        lift = thrust * rotors[i, 3]
        hx = -frame.rotor_drag * omega * (ax - r * y)
        hy = -frame.rotor_drag * omega * (ay + r * x)
        fx += hx
        fy += hy
        fz -= lift
        mx -= y * lift
        my += x * lift
        mz += x * hy - y * hx + rotors[i, 2] * frame.torque_per_thrust * thrust
    drag = 0.5 * density * frame.drag_area * np.sqrt(ax * ax + ay * ay + az * az)
    g = contact(state, ground_down_m, wheels)
    return (
        fx - drag * ax + g[0],
        fy - drag * ay + g[1],
        fz - drag * az + g[2],
        mx - frame.damping * p + g[3],
        my - frame.damping * q + g[4],
        mz - frame.damping * r + g[5],
    )


@inlined
def _spun(speeds: Array, wanted: Array, frame: Airframe, dt: float) -> Array:
    """Motor speeds `dt` later, exactly."""
    out = np.empty_like(speeds)
    for i in range(speeds.shape[0]):
        lag = frame.spin_up_s if wanted[i] > speeds[i] else frame.spin_down_s
        out[i] = wanted[i] + (speeds[i] - wanted[i]) * np.exp(-dt / lag)
    return out


@inlined
def _commanded(controls: Array, sag: float, rotors: Array, frame: Airframe) -> Array:
    """Motor speeds [rad/s] that the motors run to; arguments as in `fly`."""
    out = np.zeros(controls.shape[0])
    for i in range(controls.shape[0]):
        u = min(1.0, max(0.0, controls[i]))
        if u > 0.0:
            out[i] = frame.idle + (frame.full * sag - frame.idle) * u
        # Power goes into thrust with the square of the speed, so efficiency with its root.
        out[i] *= np.sqrt(max(0.0, rotors[i, 4]))
    return out


@inlined
def _step(
    s: State13,
    speeds: tuple[Array, Array, Array],
    rotors: Array,
    w: tuple[float, float, float],
    g: tuple[float, float, float],
    rho: float,
    ground: float,
    body: Inertia,
    frame: Airframe,
    wheels: Gear,
    dt: float,
) -> State13:
    """One Runge-Kutta step; motor speeds at its beginning, middle and end."""
    f = loads(s, speeds[0], rotors, w, rho, ground, frame, wheels)
    k1 = rigid_body(s, (f[0], f[1], f[2]), (f[3], f[4], f[5]), g, body)
    s2 = moved(s, k1, 0.5 * dt)
    f = loads(s2, speeds[1], rotors, w, rho, ground, frame, wheels)
    k2 = rigid_body(s2, (f[0], f[1], f[2]), (f[3], f[4], f[5]), g, body)
    s3 = moved(s, k2, 0.5 * dt)
    f = loads(s3, speeds[1], rotors, w, rho, ground, frame, wheels)
    k3 = rigid_body(s3, (f[0], f[1], f[2]), (f[3], f[4], f[5]), g, body)
    s4 = moved(s, k3, dt)
    f = loads(s4, speeds[2], rotors, w, rho, ground, frame, wheels)
    k4 = rigid_body(s4, (f[0], f[1], f[2]), (f[3], f[4], f[5]), g, body)
    return runge_kutta(s, k1, k2, k3, k4, dt)


@compiled
def fly(
    x: Array,
    controls: Array,
    sag: float,
    rotors: Array,
    wind: Array,
    gravity: Array,
    air_ground: tuple[float, float],
    steps: int,
    dt: float,
    packed: Array,
    points_m: Array,
) -> tuple[Array, Array]:
    """Advance the state by `steps` Runge-Kutta steps of `dt` seconds.

    Parameters
    ----------
    x : array, shape (15 + n,)
        For n motors.
    controls : array, shape (n,)
        0 to 1 between idle and full speed, clipped; 0 stops the motor.
    sag : float
        Battery voltage over that of a full pack, which lowers the full speed.
    rotors : array, shape (n, 5)
        As in `loads`, and in the last column what is left of the motor's power.
    wind, gravity : arrays, shape (3,)
        NED [m/s], [m/s^2].
    air_ground : 2 floats
        Air density [kg/m^3] and the ground's down coordinate [m].
    packed, points_m : arrays
        From `pack`, and the contact points (m, 3).

    Returns
    -------
    x : array, shape (15 + n,)
    load : array, shape (4,)
        Specific force in body axes at the new state [m/s^2]; mean cube of the motors' speeds over
        full speed, as shaft power goes with the cube.
    """
    rho, ground = air_ground
    body = Inertia(*to_fixed_tuple(packed[:_BODY], _BODY))
    frame = Airframe(*to_fixed_tuple(packed[_BODY:_END], _FRAME))
    wheels = Gear(points_m, packed[_END], packed[_END + 1], packed[_END + 2], packed[_END + 3])
    w = (wind[0], wind[1], wind[2])
    g = (gravity[0], gravity[1], gravity[2])
    s = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12])
    n = controls.shape[0]
    wanted = _commanded(controls, sag, rotors, frame)
    speeds = x[13 : 13 + n].copy()
    for _ in range(steps):
        half = _spun(speeds, wanted, frame, 0.5 * dt)
        after = _spun(speeds, wanted, frame, dt)
        s = _step(s, (speeds, half, after), rotors, w, g, rho, ground, body, frame, wheels, dt)
        speeds = after
    f = loads(s, speeds, rotors, w, rho, ground, frame, wheels)
    out = np.empty_like(x)
    for i in range(13):
        out[i] = s[i]
    out[13 : 13 + n] = speeds
    out[13 + n :] = x[13 + n :]
    load = np.zeros(4)
    for i in range(3):
        load[i] = f[i] / body.mass_kg
    for i in range(n):
        load[3] += (speeds[i] / frame.full) ** 3 / n
    return out, load
