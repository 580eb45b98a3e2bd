"""Trim of the fixed wing and its linear model about the trim.

The 12 states here are those of Beard and McLain (3-2-1 Euler angles instead of the quaternion):
position NED, u, v, w, roll, pitch, yaw, p, q, r.
"""

import math
from dataclasses import dataclass
from typing import cast

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.rotations.rotation import quat_from_euler
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero, WingInputs, state_derivative
from simvehicle.vehicles.rigidbody_kernel import E0, Inertia, P, State13, U, V, W
from simvehicle.vehicles.solution import round_solution

ROLL, PITCH, RATES = 6, 7, 9  # index, or start, in the 12 states
LATERAL = [V, ROLL, RATES, RATES + 2]
H = 1e-6  # of central differences: about the cube root of the rounding error, their optimum
NEWTON_STEPS = 12  # 5 reach the rounding error from the start, at all speeds of the shipped sets
MAX_STEP = 0.2  # rad, or of the squared throttle: keeps steps within what an airframe can do
MAX_ALPHA_RAD = 0.4  # beyond the stall of every shipped airframe


@dataclass(frozen=True, slots=True)
class TrimPoint:
    """A trim point: straight, unaccelerated flight without wind; angles and deflections in rad."""

    airspeed_mps: float
    alpha_rad: float
    pitch_rad: float
    elevator_rad: float
    throttle: float
    roll_rad: float = 0.0
    aileron_rad: float = 0.0
    rudder_rad: float = 0.0

    def state12(self) -> Array:
        """The 12 states at the origin, heading north."""
        x = np.zeros(12)
        x[U] = self.airspeed_mps * math.cos(self.alpha_rad)
        x[W] = self.airspeed_mps * math.sin(self.alpha_rad)
        x[ROLL], x[PITCH] = self.roll_rad, self.pitch_rad
        return x

    def controls(self) -> Array:
        """Elevator, aileron, rudder [rad], throttle."""
        return np.array([self.elevator_rad, self.aileron_rad, self.rudder_rad, self.throttle])


def euler_derivative(
    x: Array, controls: Array, body: Inertia, aero: Aero, density: float, gravity: float
) -> Array:
    """Time derivative (12,) of the Euler-angle state, from the quaternion kernel."""
    roll, pitch, yaw = x[ROLL:RATES]
    q = quat_from_euler(roll, pitch, yaw)
    state = cast(State13, tuple(np.concatenate([x[:ROLL], q, x[RATES:]]).tolist()))
    de, da, dr, dt = controls.tolist()
    still, down = (0.0, 0.0, 0.0), (0.0, 0.0, gravity)
    rate = state_derivative(state, WingInputs((de, da, dr, dt), still, down, density, body, aero))
    p, qq, r = x[RATES:]
    yaw_part = qq * math.sin(roll) + r * math.cos(roll)
    angles = (
        p + yaw_part * math.tan(pitch),
        qq * math.cos(roll) - r * math.sin(roll),
        yaw_part / math.cos(pitch),
    )
    return np.array([*rate[:E0], *angles, *rate[P:]])


def find_trim(
    airspeed_mps: float,
    body: Inertia,
    aero: Aero,
    density: float = 1.2682,
    gravity: float = 9.81,
    climb_rad: float = 0.0,
) -> TrimPoint:
    """Find angle of attack, roll, deflections and throttle for straight flight without sideslip.

    The default density and gravity are those of the model's source [1]_.

    Raises
    ------
    ValueError
        If the airframe cannot fly straight at this speed.

    References
    ----------
    .. [1] Beard and McLain, Small Unmanned Aircraft, 2012, appendix E.
    """

    def point_at(z: Array) -> TrimPoint:
        # Solve for the square of the throttle: thrust laws are even in it, and the negative root
        # is not a solution.
        alpha, elevator, square, *rest = z.tolist()
        throttle = math.sqrt(max(square, 0.0))
        return TrimPoint(airspeed_mps, alpha, alpha + climb_rad, elevator, throttle, *rest)

    def residual(z: Array) -> Array:
        guess = point_at(z)
        rate = euler_derivative(guess.state12(), guess.controls(), body, aero, density, gravity)
        # Linear and angular accelerations must vanish; position may change.
        return np.concatenate([rate[3:6], rate[9:]])

    # Near the cruise of all shipped airframes: a few degrees nose up, half throttle.
    z = np.array([0.05, -0.05, 0.25, 0.0, 0.0, 0.0])
    for _ in range(NEWTON_STEPS):
        jacobian = [(residual(z + d) - residual(z - d)) / (2.0 * H) for d in H * np.eye(6)]
        step = np.linalg.lstsq(np.array(jacobian).T, residual(z))[0]
        z -= np.clip(step, -MAX_STEP, MAX_STEP)
    point = point_at(round_solution(z))
    missed = np.max(np.abs(residual(z))) > 1e-6
    if missed or point.throttle > 1.0 or abs(point.alpha_rad) > MAX_ALPHA_RAD:
        raise ValueError(
            f"no straight flight at {airspeed_mps} m/s with an angle of attack of at most "
            f"{MAX_ALPHA_RAD} rad and full throttle; choose another speed"
        )
    return point


def linearise_trim(
    point: TrimPoint, body: Inertia, aero: Aero, density: float = 1.2682, gravity: float = 9.81
) -> tuple[Array, Array]:
    """Jacobians A (12, 12) and B (12, 4) of the Euler-angle model, by central differences."""
    x, u = point.state12(), point.controls()

    def f(dx: Array, du: Array) -> Array:
        return euler_derivative(x + dx, u + du, body, aero, density, gravity)

    zero_x, zero_u = np.zeros(12), np.zeros(4)
    a = [(f(d, zero_u) - f(-d, zero_u)) / (2.0 * H) for d in H * np.eye(12)]
    b = [(f(zero_x, d) - f(zero_x, -d)) / (2.0 * H) for d in H * np.eye(4)]
    return np.array(a).T, np.array(b).T
