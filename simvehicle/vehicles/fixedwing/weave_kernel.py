"""A fixed wing that rolls from side to side at constant pitch and airspeed.

Proportional feedback of the true attitude is added to open-loop controls, so that long flights stay
within the envelope.
"""

import math

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.rotations.rotation_kernel import euler_of_quaternion

# Elevator and aileron per rad and per rad/s, throttle per m/s: bandwidths of pitch and roll of
# about 6 rad/s for the Aerosonde at 35 m/s.
PITCH_GAIN, PITCH_RATE_GAIN, ROLL_GAIN, ROLL_RATE_GAIN, SPEED_GAIN = 1.0, 0.1, 0.3, 0.05, 0.05
DEFLECTION_LIMIT_RAD = 0.4  # of the feedback alone; chosen
# Starts in a plan: roll amplitude [rad], its period [s], pitch [rad] and airspeed; the controls
# without feedback, elevator, aileron, rudder [rad] and throttle; what is full deflection of each.
OPEN_LOOP, THROW, PLAN_SIZE = 4, 8, 12


@inlined
def _limited(deflection: float) -> float:
    return min(DEFLECTION_LIMIT_RAD, max(-DEFLECTION_LIMIT_RAD, deflection))


@compiled
def weave_controls(
    t_s: float, q_nb: Array, omega_b_rps: Array, v_air_b_mps: Array, plan: Array, out: Array
) -> None:
    """Set `out` (4,) to elevator, aileron, rudder (-1 to 1) and throttle at a time since the start.

    Attitude (4,), body rates (3,) and velocity through the air (3,) are the feedback; `plan`
    (PLAN_SIZE,).
    """
    roll, pitch, _ = euler_of_quaternion(q_nb)
    u, v, w = v_air_b_mps[0], v_air_b_mps[1], v_air_b_mps[2]
    sine = math.sin(2.0 * math.pi * t_s / plan[1])
    elevator = PITCH_RATE_GAIN * omega_b_rps[1] - PITCH_GAIN * (plan[2] - pitch)
    aileron = ROLL_GAIN * (plan[0] * sine - roll) - ROLL_RATE_GAIN * omega_b_rps[0]
    throttle = plan[OPEN_LOOP + 3] + SPEED_GAIN * (plan[3] - math.sqrt(u * u + v * v + w * w))
    out[0] = plan[OPEN_LOOP] + _limited(elevator)
    out[1] = plan[OPEN_LOOP + 1] + _limited(aileron)
    out[2] = plan[OPEN_LOOP + 2]
    out[3] = min(1.0, max(0.0, throttle))
    for i in range(4):
        out[i] /= plan[THROW + i]
