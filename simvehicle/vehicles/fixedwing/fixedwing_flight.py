"""The fixed wing of the interactive simulator: the kernel with ground contact and battery.

The state array has 14 entries: the 13 of `rigidbody_kernel` and the charge drawn [A s].
"""

from typing import NamedTuple

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, constant, inlined
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body
from simvehicle.vehicles.battery_kernel import BatterySupply, battery_output
from simvehicle.vehicles.contact_kernel import Gear, contact_loads
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero, forces_moments, propulsion_output
from simvehicle.vehicles.rigidbody_kernel import (
    RIGID_SIZE,
    Inertia,
    Loads,
    State13,
    runge_kutta_step,
)
from simvehicle.vehicles.vehicle import (
    CHARGE,
    CURRENT,
    DENSITY,
    FORCE,
    GRAVITY,
    GROUND,
    VOLTS,
    WIND,
)

_CONTACT_CHECK_M = 5.0  # chosen: no part of the vehicle reaches the ground above this height
_BRAKE_FRICTION = 0.4  # friction coefficient along the body while the throttle is closed; chosen
# Index of the drawn charge, and length of a state
CHARGE_DRAWN, STATE_SIZE = RIGID_SIZE, RIGID_SIZE + 1
ELEVATOR, AILERON, RUDDER, THROTTLE = range(4)  # indices of the controls
_NOW = constant(0)  # the stage at the beginning of a step
_BODY = len(Inertia._fields)
_AERO = len(Aero._fields)
_SUPPLY = len(BatterySupply._fields)
_POWERED = _BODY + _AERO
_END = _POWERED + _SUPPLY
# What `pack_parameters` appends to the named tuples; the contact points come last.
_STIFFNESS, _DAMPING, _ALONG, _ACROSS, _SHIFT, _THROW, _POINTS = (*range(_END, _END + 6), _END + 8)


class _LoadInputs(NamedTuple):
    """Inputs of the loads besides the state; constant over a step."""

    surfaces: tuple[float, float, float, float]
    wind: tuple[float, float, float]
    density: float
    ground: float
    aero: Aero
    wheels: Gear
    shift: float


def pack_parameters(
    body: Inertia, aero: Aero, wheels: Gear, supply: BatterySupply, shift_x_m: float,
    throw_rad: tuple[float, float, float],
) -> Array:  # fmt: skip
    """Pack all parameters of `integrate_flight` into one array; the contact points come last.

    `shift_x_m` is the position of the centre of mass ahead of the coefficients' reference point,
    `throw_rad` the maximum deflections of elevator, aileron and rudder.
    """
    return np.array(
        [*body, *aero, *supply, *wheels[1:], shift_x_m, *throw_rad, *wheels.points_m.ravel()]
    )


@inlined
def _loads(state: State13, stage: int, given: _LoadInputs) -> Loads:
    """Loads of air, propeller and ground; the stage of the step has no effect."""
    _, _, down, u, v, w, e0, e1, e2, e3, p, q, r = state
    wind = given.wind
    wx, wy, wz = to_body(e0, e1, e2, e3, wind[0], wind[1], wind[2])
    fx, fy, fz, mx, my, mz = forces_moments(
        (u - wx, v - wy, w - wz), (p, q, r), given.surfaces, given.density, given.aero
    )
    # The force acts at the reference point of the coefficients.
    my += given.shift * fz
    mz -= given.shift * fy
    # Down is positive: compute ground contact only near the ground.
    if down > given.ground - _CONTACT_CHECK_M:
        gx, gy, gz, gl, gm, gn = contact_loads(state, given.ground, given.wheels)
        fx, fy, fz = fx + gx, fy + gy, fz + gz
        mx, my, mz = mx + gl, my + gm, mz + gn
    return fx, fy, fz, mx, my, mz


@inlined
def _clip(value: float, low: float, high: float) -> float:
    return min(high, max(low, value))


@inlined
def _commanded_surfaces(controls: Array, packed: Array) -> tuple[float, float, float, float]:
    """Commanded deflections [rad] and throttle, within their limits."""
    return (
        _clip(controls[ELEVATOR], -1.0, 1.0) * packed[_THROW + ELEVATOR],
        _clip(controls[AILERON], -1.0, 1.0) * packed[_THROW + AILERON],
        _clip(controls[RUDDER], -1.0, 1.0) * packed[_THROW + RUDDER],
        _clip(controls[THROTTLE], 0.0, 1.0),
    )


@compiled
def integrate_flight(
    x: Array,
    controls: Array,
    surroundings: Array,
    steps: int,
    dt: float,
    packed: Array,
    after: Array,
    load: Array,
) -> None:
    """Advance the state by `steps` steps of `dt` seconds.

    Output arrays are passed in and filled, as numba takes a microsecond to return one.

    Parameters
    ----------
    x : array, shape (14,)
    controls : array, shape (4,)
        Elevator, aileron, rudder (-1 to 1 of full deflection), throttle (0 to 1); clipped.
    surroundings : array, shape (8,)
        From `vehicle.pack_surroundings`.
    packed : array
        From `pack_parameters`; passing named tuples to numba would take some microseconds each.
    after : array, shape (14,)
        Set to the new state.
    load : array, shape (6,)
        Set to the load of `vehicle.Vehicle.advance`.
    """
    body = Inertia(*to_fixed_tuple(packed[:_BODY], _BODY))
    aero = Aero(*to_fixed_tuple(packed[_BODY:_POWERED], _AERO))
    supply = BatterySupply(*to_fixed_tuple(packed[_POWERED:_END], _SUPPLY))
    # With the throttle closed the brakes are applied.
    rolling = packed[_ALONG] if controls[THROTTLE] > 0.0 else _BRAKE_FRICTION
    points_m = packed[_POINTS:].reshape(-1, 3)
    wheels = Gear(points_m, packed[_STIFFNESS], packed[_DAMPING], rolling, packed[_ACROSS])
    surfaces = _commanded_surfaces(controls, packed)
    wind = (surroundings[WIND], surroundings[WIND + 1], surroundings[WIND + 2])
    g = (surroundings[GRAVITY], surroundings[GRAVITY + 1], surroundings[GRAVITY + 2])
    density = surroundings[DENSITY]
    given = _LoadInputs(surfaces, wind, density, surroundings[GROUND], aero, wheels, packed[_SHIFT])
    # A tuple of scalars stays in registers over the steps.
    s = to_fixed_tuple(x[:RIGID_SIZE], RIGID_SIZE)
    for _ in range(steps):
        s = runge_kutta_step(s, _loads, given, g, body, dt)
    fx, fy, fz, _mx, _my, _mz = _loads(s, _NOW, given)
    _, _, _, u, v, w, e0, e1, e2, e3, _, _, _ = s
    wx, wy, wz = to_body(e0, e1, e2, e3, wind[0], wind[1], wind[2])
    airspeed = np.sqrt((u - wx) ** 2 + (v - wy) ** 2 + (w - wz) ** 2)
    # The current of the last step is used for all of them.
    _, _, current = propulsion_output(airspeed, surfaces[THROTTLE], density, aero)
    # The thrust law of the first edition has no current: assume proportionality to throttle.
    if supply.full_throttle_a > 0.0:
        current = supply.full_throttle_a * surfaces[THROTTLE]
    for i in range(RIGID_SIZE):
        after[i] = s[i]
    after[CHARGE_DRAWN] = x[CHARGE_DRAWN] + current * steps * dt
    load[FORCE], load[FORCE + 1] = fx / body.mass_kg, fy / body.mass_kg
    load[FORCE + 2] = fz / body.mass_kg
    load[CURRENT] = current
    load[VOLTS], load[CHARGE] = battery_output(supply, after[CHARGE_DRAWN], current)
