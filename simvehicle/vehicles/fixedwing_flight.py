"""The fixed wing as the interactive simulator flies it: the kernel with ground and battery.

The state array has 14 entries: the 13 of `rigidbody_kernel` and the charge drawn [A s].
"""

from typing import NamedTuple

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.rotation_kernel import to_body
from simvehicle.vehicles.contact_kernel import Gear, contact
from simvehicle.vehicles.fixedwing_kernel import Aero, forces_moments, propulsion
from simvehicle.vehicles.rigidbody_kernel import Inertia, Loads, State13, integrated
from simvehicle.vehicles.vehicle import DENSITY, GRAVITY, GROUND, WIND

Array = NDArray[np.float64]
_CLEAR_M = 5.0  # above this height nothing can touch the ground
_BRAKES = 0.4  # friction along the body while the throttle is closed
_BODY = len(Inertia._fields)
_AERO = len(Aero._fields)
_END = _BODY + _AERO
_POINTS = _END + 8  # after the rest of the gear, the shift and the throws


class _Given(NamedTuple):
    """What the loads depend on besides the state; constant over a step."""

    surfaces: tuple[float, float, float, float]
    wind: tuple[float, float, float]
    density: float
    ground: float
    aero: Aero
    wheels: Gear
    shift: float


def pack(
    body: Inertia, aero: Aero, wheels: Gear, shift_x_m: float, throw_rad: tuple[float, float, float]
) -> Array:
    """All parameters of `fly` in one array; the contact points are its end.

    `shift_x_m` is how far the centre of mass lies ahead of where the coefficients hold, `throw_rad`
    the largest deflections of elevator, aileron and rudder.
    """
    return np.array([*body, *aero, *wheels[1:], shift_x_m, *throw_rad, *wheels.points_m.ravel()])


@inlined
def _loads(state: State13, stage: int, given: _Given) -> Loads:
    """Air, propeller and ground; the same at every stage of a step."""
    wind = given.wind
    wx, wy, wz = to_body(state[6], state[7], state[8], state[9], wind[0], wind[1], wind[2])
    air = (state[3] - wx, state[4] - wy, state[5] - wz)
    rates = (state[10], state[11], state[12])
    fx, fy, fz, mx, my, mz = forces_moments(air, rates, given.surfaces, given.density, given.aero)
    # The coefficients hold about the old centre of mass; the force acts there still.
    my += given.shift * fz
    mz -= given.shift * fy
    # Down is positive: this is below five metres, higher up there is nothing to touch.
    if state[2] > given.ground - _CLEAR_M:
        g = contact(state, given.ground, given.wheels)
        fx, fy, fz = fx + g[0], fy + g[1], fz + g[2]
        mx, my, mz = mx + g[3], my + g[4], mz + g[5]
    return fx, fy, fz, mx, my, mz


@inlined
def _clipped(value: float, low: float, high: float) -> float:
    return min(high, max(low, value))


@inlined
def _surfaces(controls: Array, packed: Array) -> tuple[float, float, float, float]:
    """Deflections [rad] and throttle that are commanded, within their limits."""
    return (
        _clipped(controls[0], -1.0, 1.0) * packed[_END + 5],
        _clipped(controls[1], -1.0, 1.0) * packed[_END + 6],
        _clipped(controls[2], -1.0, 1.0) * packed[_END + 7],
        _clipped(controls[3], 0.0, 1.0),
    )


@compiled
def fly(
    x: Array,
    controls: Array,
    around: Array,
    steps: int,
    dt: float,
    packed: Array,
    after: Array,
    load: Array,
) -> None:
    """Advance the state by `steps` steps of `dt` seconds.

    Arrays are handed in and filled, as numba takes a microsecond to hand one back.

    Parameters
    ----------
    x : array, shape (14,)
    controls : array, shape (4,)
        Elevator, aileron, rudder (-1 to 1 of full throw), throttle (0 to 1); clipped.
    around : array, shape (8,)
        The wind [m/s] and gravity [m/s^2], both NED, the density of the air [kg/m^3] and the
        ground's down coordinate [m]; from `vehicle.surroundings`.
    packed : array
        From `pack`; handing numba the named tuples themselves costs some microseconds each.
    after : array, shape (14,)
        Becomes the new state.
    load : array, shape (>= 5,)
        Becomes the specific force in body axes [m/s^2] at the new state, and [4] the motor
        current [A].
    """
    body = Inertia(*to_fixed_tuple(packed[:_BODY], _BODY))
    aero = Aero(*to_fixed_tuple(packed[_BODY:_END], _AERO))
    # A pilot who closes the throttle on the ground brakes.
    rolling = packed[_END + 2] if controls[3] > 0.0 else _BRAKES
    points_m = packed[_POINTS:].reshape(-1, 3)
    wheels = Gear(points_m, packed[_END], packed[_END + 1], rolling, packed[_END + 3])
    surfaces = _surfaces(controls, packed)
    w = (around[WIND], around[WIND + 1], around[WIND + 2])
    g = (around[GRAVITY], around[GRAVITY + 1], around[GRAVITY + 2])
    density = around[DENSITY]
    given = _Given(surfaces, w, density, around[GROUND], aero, wheels, packed[_END + 4])
    # A tuple: scalars stay in registers over the steps.
    s = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12])
    for _ in range(steps):
        s = integrated(s, _loads, given, g, body, dt)
    fx, fy, fz, _mx, _my, _mz = _loads(s, 0, given)
    wx, wy, wz = to_body(s[6], s[7], s[8], s[9], w[0], w[1], w[2])
    airspeed = np.sqrt((s[3] - wx) ** 2 + (s[4] - wy) ** 2 + (s[5] - wz) ** 2)
    # The current of the last step stands for all of them.
    current = propulsion(airspeed, surfaces[3], density, aero)[2]
    for i in range(13):
        after[i] = s[i]
    after[13] = x[13] + current * steps * dt
    load[0] = fx / body.mass_kg
    load[1] = fy / body.mass_kg
    load[2] = fz / body.mass_kg
    load[4] = current
