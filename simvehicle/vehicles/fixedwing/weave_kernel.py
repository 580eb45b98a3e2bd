"""A fixed wing that rolls from side to side at constant pitch and airspeed: a scalar kernel.

Proportional feedback of the true attitude is added to open-loop controls, so that long flights stay
within the envelope. The simulator calls it for one vehicle, the worst-case search for many.
"""

from math import pi
from typing import NamedTuple

from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.polynomial import sin_cos

# Elevator and aileron per rad and per rad/s, throttle per m/s: bandwidths of pitch and roll of
# about 6 rad/s for the Aerosonde at 35 m/s.
PITCH_GAIN, PITCH_RATE_GAIN, ROLL_GAIN, ROLL_RATE_GAIN, SPEED_GAIN = 1.0, 0.1, 0.3, 0.05, 0.05
DEFLECTION_LIMIT_RAD = 0.4  # of the feedback alone; chosen

Four = tuple[float, float, float, float]


class WeaveFeedback(NamedTuple):
    """Feedback: roll, pitch [rad], body rates p, q [rad/s] and airspeed."""

    roll: float
    pitch: float
    p: float
    q: float
    airspeed_mps: float


@inlined
def weave_controls(motion: WeaveFeedback, aim: Four, open_loop: Four, t_s: float) -> Four:
    """Elevator, aileron, rudder [rad] and throttle.

    Parameters
    ----------
    motion : Motion
    aim : 4 floats
        Roll amplitude [rad], its period [s], pitch [rad], airspeed [m/s].
    open_loop : 4 floats
        Controls without feedback.
    t_s : float
        Time since the start.
    """
    roll_rad, period_s, pitch_rad, airspeed_mps = aim
    elevator, aileron, rudder, throttle = open_loop
    sine, _ = sin_cos(2.0 * pi * t_s / period_s)
    more_elevator = PITCH_RATE_GAIN * motion.q - PITCH_GAIN * (pitch_rad - motion.pitch)
    more_aileron = ROLL_GAIN * (roll_rad * sine - motion.roll) - ROLL_RATE_GAIN * motion.p
    throttle += SPEED_GAIN * (airspeed_mps - motion.airspeed_mps)
    return (
        elevator + min(DEFLECTION_LIMIT_RAD, max(-DEFLECTION_LIMIT_RAD, more_elevator)),
        aileron + min(DEFLECTION_LIMIT_RAD, max(-DEFLECTION_LIMIT_RAD, more_aileron)),
        rudder,
        min(1.0, max(0.0, throttle)),
    )
