"""Forces, moments and integration of a multirotor, compiled.

Rotor thrust is proportional to the square of the motor's speed and to air density; the drag of a
rotor's disc is linear in the speed across its axis (Martin and Salaun, ICRA 2010; the model of the
RotorS simulator, Furrer et al. 2016). Motors follow their commands with first-order lags. The state
array has the 13 entries of `rigidbody_kernel`, the motor speeds [rad/s], the rotors' angles [rad],
the current [A] and the charge drawn [A s].
"""

import math
from typing import NamedTuple

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, constant, inlined
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body
from simvehicle.vehicles.battery_kernel import BatterySupply, battery_output
from simvehicle.vehicles.contact_kernel import Gear, contact_loads
from simvehicle.vehicles.rigidbody_kernel import (
    RIGID_SIZE,
    Inertia,
    Loads,
    State13,
    runge_kutta_step,
)
from simvehicle.vehicles.vehicle import (
    BATTERY_SAG,
    CHARGE,
    CURRENT,
    DENSITY,
    FORCE,
    GRAVITY,
    GROUND,
    VOLTS,
    WIND,
)


class Airframe(NamedTuple):
    """Coefficients of rotors and body in SI units, and the offset of the centre of mass."""

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


class _LoadInputs(NamedTuple):
    """Inputs of the loads besides the state.

    `speeds` (3, n) are the motor speeds at start, middle and end of a step [rad/s]; `rotors` (n, 7)
    holds x, y [m], the sign of the reaction torque, the efficiencies of propeller and motor, and
    the unbalance [kg m] and the ripple of the thrust, as a part of it.
    """

    speeds: Array
    rotors: Array
    wind: tuple[float, float, float]
    density: float
    ground: float
    frame: Airframe
    wheels: Gear


_NOW = constant(0)  # the stage at the beginning of a step
_BODY = len(Inertia._fields)
_FRAME = len(Airframe._fields)
_SUPPLY = len(BatterySupply._fields)
_POWERED = _BODY + _FRAME
_END = _POWERED + _SUPPLY
# What `pack_parameters` appends to the named tuples; rotors and contact points come last.
_STIFFNESS, _DAMPING, _ALONG, _ACROSS, _ROTORS = range(_END, _END + 5)
_CURRENT, _CHARGE_DRAWN = -2, -1  # in the state
_FULL_CELL_V = 4.2  # the full speed in a parameter file is that at full charge
# Columns of a rotor after x
_RIGHT, _REACTION, _PROPELLER, _POWER, _UNBALANCE, _RIPPLE, _ROTOR = range(1, 8)
_STILL_RPS = 1.0  # below it an unbalance of 1e-3 kg m exerts less than 1 mN


def pack_parameters(
    body: Inertia, frame: Airframe, wheels: Gear, supply: BatterySupply, rotors: Array
) -> Array:
    """Pack all parameters of `integrate_flight` into one array; rotors (n, 7) and points last."""
    ends = (rotors.ravel(), wheels.points_m.ravel())
    return np.concatenate([[*body, *frame, *supply, *wheels[1:]], *ends])


@inlined
def rotor_loads(
    air: tuple[float, float],
    yaw_rate: float,
    omega: float,
    at: tuple[float, float, float, float],
    density: float,
    frame: Airframe,
) -> Loads:
    """Force [N] and moment [N m] of one rotor at `omega` rad/s.

    `air` is the body's velocity through the air, forward and right; `at` is the rotor's position
    [m], the sign of its reaction torque and its propeller's efficiency.
    """
    right = at[1] - frame.shift_y
    x = at[0] - frame.shift_x
    thrust = frame.thrust * omega * omega * density / SEA_LEVEL_DENSITY_KGPM3
    lift = thrust * at[3]
    # The yaw rate adds to the airspeed at the rotor's position.
    hx = -frame.rotor_drag * omega * (air[0] - yaw_rate * right)
    hy = -frame.rotor_drag * omega * (air[1] + yaw_rate * x)
    # Down is positive, so lift is negative. Yaw: disc drag times its arm, and the propeller's
    # reaction torque.
    turn = x * hy - right * hx + at[2] * frame.torque_per_thrust * thrust
    return hx, hy, -lift, -right * lift, x * lift, turn


@inlined
def body_drag(
    air: tuple[float, float, float],
    rates: tuple[float, float, float],
    density: float,
    frame: Airframe,
) -> Loads:
    """Aerodynamic force [N] and moment [N m] on the body without the rotors."""
    x, y, z = air
    drag = 0.5 * density * frame.drag_area * np.sqrt(x * x + y * y + z * z)
    p, q, r = rates
    return (
        -drag * x, -drag * y, -drag * z,
        -frame.damping * p, -frame.damping * q, -frame.damping * r,
    )  # fmt: skip


@inlined
def _loads(state: State13, stage: int, given: _LoadInputs) -> Loads:
    """Loads of rotors, body drag and ground."""
    rotors, frame, density, wind = given.rotors, given.frame, given.density, given.wind
    # Runge-Kutta stages 1 and 2 are both at the middle of the step.
    when = (stage + 1) // 2
    _, _, _, u, v, w, e0, e1, e2, e3, p, q, r = state
    wx, wy, wz = to_body(e0, e1, e2, e3, wind[0], wind[1], wind[2])
    ax, ay, az = u - wx, v - wy, w - wz
    fx, fy, fz, mx, my, mz = contact_loads(state, given.ground, given.wheels)
    for i in range(rotors.shape[0]):
        at = (rotors[i, 0], rotors[i, _RIGHT], rotors[i, _REACTION], rotors[i, _PROPELLER])
        one = rotor_loads((ax, ay), r, given.speeds[when, i], at, density, frame)
        fx, fy, fz = fx + one[0], fy + one[1], fz + one[2]
        mx, my, mz = mx + one[3], my + one[4], mz + one[5]
    rest = body_drag((ax, ay, az), (p, q, r), density, frame)
    return (
        fx + rest[0], fy + rest[1], fz + rest[2],
        mx + rest[3], my + rest[4], mz + rest[5],
    )  # fmt: skip


@inlined
def commanded_speed(control: float, sag: float, power: float, frame: Airframe) -> float:
    """Steady speed [rad/s] of a motor; `power` scales the thrust, so its root the speed."""
    u = min(1.0, max(0.0, control))
    # At 0 a motor is stopped; just above 0 it idles, as armed speed controllers do.
    speed = frame.idle + (frame.full * sag - frame.idle) * u if u > 0.0 else 0.0
    return speed * math.sqrt(max(0.0, power))


@inlined
def _spin_motors(
    speeds: Array, controls: Array, sag: float, rotors: Array, frame: Airframe, dt: float
) -> None:
    """Compute the motor speeds at the middle and the end of a step, exactly."""
    for i in range(controls.shape[0]):
        steady_speed = commanded_speed(controls[i], sag, rotors[i, _POWER], frame)
        # Braking is weaker than driving: spinning down takes longer.
        lag = frame.spin_up_s if steady_speed > speeds[0, i] else frame.spin_down_s
        remaining = math.exp(-0.5 * dt / lag)  # of the difference after half a step
        speeds[1, i] = steady_speed + (speeds[0, i] - steady_speed) * remaining
        speeds[2, i] = steady_speed + (speeds[0, i] - steady_speed) * remaining * remaining


@inlined
def _vibration(
    rotor: Array, angle: float, omega: float, dt: float, frame: Airframe
) -> tuple[float, float, float]:
    """Mean force [N] over `dt` seconds of one rotor's vibration, body axes.

    An unbalance U turns with the rotor and pulls with U omega^2 (ISO 21940-1); the thrust of two
    blades varies at twice their speed (Johnson, Rotorcraft Aeromechanics, 2013). The mean is exact:
    as in an IMU that integrates, fast vibration is attenuated.
    """
    if omega < _STILL_RPS:
        return 0.0, 0.0, 0.0
    end = angle + omega * dt
    pull = rotor[_UNBALANCE] * omega / dt  # U omega^2 over the angle turned
    thrust = rotor[_RIPPLE] * frame.thrust * omega / (2.0 * dt)
    return (
        pull * (math.sin(end) - math.sin(angle)),
        # Counterclockwise seen from above is a negative turn about the body z axis.
        rotor[_REACTION] * pull * (math.cos(end) - math.cos(angle)),
        thrust * (math.sin(2.0 * angle) - math.sin(2.0 * end)),
    )


@inlined
def _turn_rotors(
    x: Array,
    after: Array,
    load: Array,
    omegas: Array,
    rotors: Array,
    frame: Airframe,
    mass: float,
    dt: float,
) -> None:
    """Turn the rotors for `dt` seconds at speeds (n,), and add their vibration to the load."""
    n = len(rotors)
    for i in range(n):
        angle, omega = x[RIGID_SIZE + n + i], omegas[i]
        after[RIGID_SIZE + i] = omega
        after[RIGID_SIZE + n + i] = (angle + omega * dt) % math.tau
        if rotors[i, _UNBALANCE] != 0.0 or rotors[i, _RIPPLE] != 0.0:
            shaking = _vibration(rotors[i], angle, omega, dt, frame)
            for axis in range(3):
                load[FORCE + axis] += shaking[axis] / mass


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
    """Advance the state by `steps` Runge-Kutta steps of `dt` seconds.

    Parameters are those of the fixed wing's `integrate_flight`, except these, with n motors:

    Parameters
    ----------
    x, after : arrays, shape (15 + 2n,)
    controls : array, shape (n,)
        0 to 1 between idle and full speed, clipped; 0 stops the motor.
    surroundings : array, shape (9,)
        The last entry is overwritten with the battery's voltage sag, which lowers full speed.
    load : array, shape (6,)
    """
    body = Inertia(*to_fixed_tuple(packed[:_BODY], _BODY))
    frame = Airframe(*to_fixed_tuple(packed[_BODY:_POWERED], _FRAME))
    supply = BatterySupply(*to_fixed_tuple(packed[_POWERED:_END], _SUPPLY))
    # The voltage under the current of the last step limits the motors.
    load[VOLTS], load[CHARGE] = battery_output(supply, x[_CHARGE_DRAWN], x[_CURRENT])
    surroundings[BATTERY_SAG] = min(1.0, load[VOLTS] / (supply.cells * _FULL_CELL_V))
    n = controls.shape[0]
    # After the fixed part of `packed` come seven numbers per rotor, then the contact points.
    points = _ROTORS + _ROTOR * n
    rotors, points_m = packed[_ROTORS:points].reshape(n, _ROTOR), packed[points:].reshape(-1, 3)
    wheels = Gear(points_m, packed[_STIFFNESS], packed[_DAMPING], packed[_ALONG], packed[_ACROSS])
    speeds = np.empty((3, n))
    for i in range(n):
        speeds[0, i] = x[RIGID_SIZE + i]
    w = (surroundings[WIND], surroundings[WIND + 1], surroundings[WIND + 2])
    g = (surroundings[GRAVITY], surroundings[GRAVITY + 1], surroundings[GRAVITY + 2])
    given = _LoadInputs(
        speeds, rotors, w, surroundings[DENSITY], surroundings[GROUND], frame, wheels
    )
    s = to_fixed_tuple(x[:RIGID_SIZE], RIGID_SIZE)
    for _ in range(steps):
        _spin_motors(speeds, controls, surroundings[BATTERY_SAG], rotors, frame, dt)
        s = runge_kutta_step(s, _loads, given, g, body, dt)
        for i in range(n):
            speeds[0, i] = speeds[2, i]
    # After the last step the stage 0 speeds are the current ones.
    f = _loads(s, _NOW, given)
    for i in range(RIGID_SIZE):
        after[i] = s[i]
    for i in range(3):
        load[FORCE + i] = f[i] / body.mass_kg
    power = 0.0  # mean cube of the speeds relative to full speed
    for i in range(n):
        power += (speeds[0, i] / frame.full) ** 3 / n
    after[_CURRENT] = load[CURRENT] = supply.full_throttle_a * power
    after[_CHARGE_DRAWN] = x[_CHARGE_DRAWN] + load[CURRENT] * steps * dt
    _turn_rotors(x, after, load, speeds[0], rotors, frame, body.mass_kg, steps * dt)
