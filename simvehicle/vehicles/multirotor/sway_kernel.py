"""A quadrotor that rolls from side to side while it holds pitch and height: scalar compiled code.

Feedback of the true state, since a quadrotor without any falls over. The simulator calls it for
one vehicle, the worst-case search for many.
"""

from math import pi
from typing import NamedTuple

import numpy as np

from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.polynomial import sin_cos
from simvehicle.vehicles.multirotor.multirotor import Multirotor

MOTOR_COUNT = 4
# As the built-in controller has them: angle to rate, rate to angular acceleration [1/s], the
# heading slower; height to climb, climb to acceleration [1/s].
ATTITUDE_GAIN, RATE_GAIN, YAW_SHARE = 8.0, 22.0, 0.3
HEIGHT_GAIN, CLIMB_GAIN, CLIMB_LIMIT_MPS = 1.2, 2.5, 2.0
TILT_COSINE_MIN = 0.3  # of the cosine of the tilt: beyond, more thrust lifts no more

Four = tuple[float, float, float, float]
Three = tuple[float, float, float]


class QuadParameters(NamedTuple):
    """What turns wishes into motor commands, SI units: each motor's thrust (row) for lift and for
    moments about x, y and z; mass and moments of inertia; the motors."""

    shares: tuple[Four, Four, Four, Four]
    mass_kg: float
    moments_kgm2: Three
    thrust: float
    idle: float
    full: float


class SwayFeedback(NamedTuple):
    """What is fed back: roll and pitch [rad], body rates [rad/s], height above the wanted one [m],
    climb [m/s]."""

    roll: float
    pitch: float
    rates: Three
    above_m: float
    climb_mps: float


def quad_parameters(vehicle: Multirotor) -> QuadParameters:
    """The kernel's view of a multirotor with four rotors.

    Raises
    ------
    ValueError
        If it has another number.
    """
    if vehicle.controls_count != MOTOR_COUNT:
        raise ValueError(f"{vehicle.controls_count} rotors do not sway; {MOTOR_COUNT} do")
    motor, rotors = vehicle.parameters.motor, vehicle.rotors
    inertia = vehicle.parameters.inertia_kgm2
    reaction = rotors[:, 2] * motor.torque_per_thrust_m
    effect = np.array([np.ones(MOTOR_COUNT), -rotors[:, 1], rotors[:, 0], reaction])
    shares = np.linalg.inv(effect)
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
    now: SwayFeedback, aim: Three, quad: QuadParameters, gravity: float, dilution: float, t_s: float
) -> Four:
    """Commands (0 to 1) of the four motors.

    Parameters
    ----------
    now : Attitude
    aim : 3 floats
        Greatest roll [rad], its period [s], pitch [rad].
    quad : Quad
    gravity : float
        [m/s^2]
    dilution : float
        Density of the air over that at sea level.
    t_s : float
        Since the start.
    """
    roll_rad, period_s, pitch_rad = aim
    sine, _ = sin_cos(2.0 * pi * t_s / period_s)
    p, q, r = now.rates
    jx, jy, jz = quad.moments_kgm2
    mx = jx * RATE_GAIN * (ATTITUDE_GAIN * (roll_rad * sine - now.roll) - p)
    my = jy * RATE_GAIN * (ATTITUDE_GAIN * (pitch_rad - now.pitch) - q)
    mz = -jz * YAW_SHARE * RATE_GAIN * r
    _, cos_roll = sin_cos(now.roll)
    _, cos_pitch = sin_cos(now.pitch)
    wanted_mps = min(CLIMB_LIMIT_MPS, max(-CLIMB_LIMIT_MPS, -HEIGHT_GAIN * now.above_m))
    upward = gravity + CLIMB_GAIN * (wanted_mps - now.climb_mps)
    lift = quad.mass_kg * upward / max(TILT_COSINE_MIN, cos_roll * cos_pitch)
    first, second, third, fourth = quad.shares
    return (
        _command(first, (lift, mx, my, mz), quad, dilution),
        _command(second, (lift, mx, my, mz), quad, dilution),
        _command(third, (lift, mx, my, mz), quad, dilution),
        _command(fourth, (lift, mx, my, mz), quad, dilution),
    )


@inlined
def _command(share: Four, wanted: Four, quad: QuadParameters, dilution: float) -> float:
    """One motor's command for lift and moments; never 0, which would stop it."""
    thrust = (
        share[0] * wanted[0] + share[1] * wanted[1] + share[2] * wanted[2] + share[3] * wanted[3]
    )
    speed: float = np.sqrt(max(thrust, 0.0) / (quad.thrust * dilution))
    return min(1.0, max(0.01, (speed - quad.idle) / (quad.full - quad.idle)))
