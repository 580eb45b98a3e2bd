"""A quadrotor that rolls from side to side at constant pitch and height.

It feeds back the true state, as a quadrotor is unstable without feedback.
"""

import math

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.rotations.rotation_kernel import euler_of_quaternion
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.solution import round_solution

MOTOR_COUNT = 4
# The built-in controller's gains: angle to rate, rate to angular acceleration [1/s], scale for yaw;
# height to climb rate, climb rate to acceleration [1/s].
ATTITUDE_GAIN, RATE_GAIN, YAW_SHARE = 8.0, 22.0, 0.3
HEIGHT_GAIN, CLIMB_GAIN, CLIMB_LIMIT_MPS = 1.2, 2.5, 2.0
TILT_COSINE_MIN = 0.3  # chosen: limits the thrust at extreme tilt

# Starts in a plan: roll amplitude [rad], its period [s] and pitch [rad]; each motor's thrust (row)
# per lift and per moment about x, y and z; mass and moments of inertia; the motors' constants:
# thrust, idle and full speed; the height to hold [m].
SHARES, MASS, MOMENTS, MOTOR, HEIGHT, PLAN_SIZE = 3, 19, 20, 23, 26, 27


def sway_plan(vehicle: Multirotor, aim: tuple[float, float, float], height_m: float) -> Array:
    """The plan (PLAN_SIZE,) of a multirotor with four rotors.

    Raises
    ------
    ValueError
        If the vehicle has another number of rotors.
    """
    if vehicle.controls_count != MOTOR_COUNT:
        raise ValueError(
            f"{vehicle.controls_count} rotors cannot weave; use a vehicle with {MOTOR_COUNT}"
        )
    motor, inertia = vehicle.parameters.motor, vehicle.parameters.inertia_kgm2
    moments = (inertia.jx, inertia.jy, inertia.jz)
    constants = (motor.thrust_n_per_rps2, motor.idle_rps, motor.full_rps)
    shares = round_solution(np.linalg.inv(vehicle.thrust_effects)).ravel()
    return np.array([*aim, *shares, vehicle.parameters.mass_kg, *moments, *constants, height_m])


@compiled
def sway_commands(
    t_s: float, q_nb: Array, omega_b_rps: Array, height_m: float, climb_mps: float,
    density_ratio: float, plan: Array, out: Array,
) -> None:  # fmt: skip
    """Set `out` (4,) to the commands (0 to 1) of the four motors at a time since the start.

    Attitude (4,), body rates (3,), height and climb rate are the feedback; `density_ratio` is that
    of the air to sea level; `plan` (PLAN_SIZE,).
    """
    roll, pitch, _ = euler_of_quaternion(q_nb)
    sine = math.sin(2.0 * math.pi * t_s / plan[1])
    p, q, r = omega_b_rps[0], omega_b_rps[1], omega_b_rps[2]
    mx = plan[MOMENTS] * RATE_GAIN * (ATTITUDE_GAIN * (plan[0] * sine - roll) - p)
    my = plan[MOMENTS + 1] * RATE_GAIN * (ATTITUDE_GAIN * (plan[2] - pitch) - q)
    mz = -plan[MOMENTS + 2] * YAW_SHARE * RATE_GAIN * r
    climb_setpoint = -HEIGHT_GAIN * (height_m - plan[HEIGHT])
    climb_setpoint = min(CLIMB_LIMIT_MPS, max(-CLIMB_LIMIT_MPS, climb_setpoint))
    upward = STANDARD_GRAVITY_MPS2 + CLIMB_GAIN * (climb_setpoint - climb_mps)
    lift = plan[MASS] * upward / max(TILT_COSINE_MIN, math.cos(roll) * math.cos(pitch))
    per_square, idle, full = plan[MOTOR], plan[MOTOR + 1], plan[MOTOR + 2]
    for i in range(MOTOR_COUNT):
        share = plan[SHARES + 4 * i : SHARES + 4 * i + 4]
        thrust = share[0] * lift + share[1] * mx + share[2] * my + share[3] * mz
        speed = np.sqrt(max(thrust, 0.0) / (per_square * density_ratio))
        # Never 0, which would stop the motor.
        out[i] = min(1.0, max(0.01, (speed - idle) / (full - idle)))
