"""A quadrotor that rolls from side to side at constant pitch and height: a scalar kernel.

It feeds back the true state, as a quadrotor is unstable without feedback. The simulator calls it
for one vehicle, the worst-case search for many.
"""

from math import pi
from typing import NamedTuple

import numpy as np

from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.polynomial import sin_cos
from simvehicle.vehicles.multirotor.multirotor import Multirotor

MOTOR_COUNT = 4
# The built-in controller's gains: angle to rate, rate to angular acceleration [1/s], scale for yaw;
# height to climb rate, climb rate to acceleration [1/s].
ATTITUDE_GAIN, RATE_GAIN, YAW_SHARE = 8.0, 22.0, 0.3
HEIGHT_GAIN, CLIMB_GAIN, CLIMB_LIMIT_MPS = 1.2, 2.5, 2.0
TILT_COSINE_MIN = 0.3  # chosen: limits the thrust at extreme tilt

Four = tuple[float, float, float, float]
Three = tuple[float, float, float]


class QuadParameters(NamedTuple):
    """Parameters of the motor mixing, SI units: each motor's thrust (row) per lift and per moment
    about x, y and z; mass and moments of inertia; motor constants."""

    shares: tuple[Four, Four, Four, Four]
    mass_kg: float
    moments_kgm2: Three
    thrust: float
    idle: float
    full: float


class SwayFeedback(NamedTuple):
    """Feedback: roll and pitch [rad], body rates [rad/s], height above the setpoint [m], climb
    rate [m/s]."""

    roll: float
    pitch: float
    rates: Three
    above_m: float
    climb_mps: float


def quad_parameters(vehicle: Multirotor) -> QuadParameters:
    """The kernel's parameters of a multirotor with four rotors.

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
    shares = np.linalg.inv(vehicle.thrust_effects)
    first, second, third, fourth = (
        (float(row[0]), float(row[1]), float(row[2]), float(row[3])) for row in shares
    )
    return QuadParameters(
        (first, second, third, fourth),
        vehicle.parameters.mass_kg,
        (inertia.jx, inertia.jy, inertia.jz),
        motor.thrust_n_per_rps2,
        motor.idle_rps,
        motor.full_rps,
    )


@inlined
def sway_commands(
    feedback: SwayFeedback,
    aim: Three,
    quad: QuadParameters,
    gravity: float,
    density_ratio: float,
    t_s: float,
) -> Four:
    """Commands (0 to 1) of the four motors.

    Parameters
    ----------
    feedback : SwayFeedback
    aim : 3 floats
        Roll amplitude [rad], its period [s], pitch [rad].
    quad : Quad
    gravity : float
        [m/s^2]
    density_ratio : float
        Air density_ratio relative to sea level.
    t_s : float
        Time since the start.
    """
    roll_rad, period_s, pitch_rad = aim
    sine, _ = sin_cos(2.0 * pi * t_s / period_s)
    p, q, r = feedback.rates
    jx, jy, jz = quad.moments_kgm2
    mx = jx * RATE_GAIN * (ATTITUDE_GAIN * (roll_rad * sine - feedback.roll) - p)
    my = jy * RATE_GAIN * (ATTITUDE_GAIN * (pitch_rad - feedback.pitch) - q)
    mz = -jz * YAW_SHARE * RATE_GAIN * r
    _, cos_roll = sin_cos(feedback.roll)
    _, cos_pitch = sin_cos(feedback.pitch)
    climb_setpoint = min(CLIMB_LIMIT_MPS, max(-CLIMB_LIMIT_MPS, -HEIGHT_GAIN * feedback.above_m))
    upward = gravity + CLIMB_GAIN * (climb_setpoint - feedback.climb_mps)
    lift = quad.mass_kg * upward / max(TILT_COSINE_MIN, cos_roll * cos_pitch)
    first, second, third, fourth = quad.shares
    return (
        _command(first, (lift, mx, my, mz), quad, density_ratio),
        _command(second, (lift, mx, my, mz), quad, density_ratio),
        _command(third, (lift, mx, my, mz), quad, density_ratio),
        _command(fourth, (lift, mx, my, mz), quad, density_ratio),
    )


@inlined
def _command(share: Four, loads: Four, quad: QuadParameters, density_ratio: float) -> float:
    """One motor's command for lift and moments; never 0, which would stop the motor."""
    thrust = share[0] * loads[0] + share[1] * loads[1] + share[2] * loads[2] + share[3] * loads[3]
    speed: float = np.sqrt(max(thrust, 0.0) / (quad.thrust * density_ratio))
    return min(1.0, max(0.01, (speed - quad.idle) / (quad.full - quad.idle)))
