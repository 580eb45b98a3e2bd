"""A mission over lanes: rolling from side to side while holding pitch and airspeed.

Proportional feedback of the true attitude on top of the open-loop controls, so that long flights
stay within the envelope. A lane without a mission flies its controls as they are.
"""

from math import pi

import numpy as np

from analysis.search import rows
from analysis.search.lanes import Buffer, state_at
from analysis.search.score_lanes import euler
from analysis.search.wide import wide
from simvehicle.compiled import compiled
from simvehicle.vehicles.polynomial import sin_cos
from simvehicle.vehicles.rigidbody_kernel import to_body

L = rows.LANES
C, O, T, W = rows.CONTROL * L, rows.OPEN_LOOP * L, rows.MISSION * L, rows.WIND * L  # noqa: E741
# Elevator and aileron per rad and per rad/s, throttle per m/s: the loops of pitch and roll lie
# near 6 rad/s for the Aerosonde at 35 m/s.
PITCH, PITCH_RATE, ROLL, ROLL_RATE, SPEED = 1.0, 0.1, 0.3, 0.05, 0.05
THROW_RAD = 0.5


@compiled
def steer(buf: Buffer, t_s: float) -> None:
    """CONTROL from OPEN_LOOP and, where there is a mission, feedback."""
    wide()
    for lane in range(L):
        state = state_at(buf, lane)
        on = buf[T + lane] > 0.5
        e0, e1, e2, e3 = state[6], state[7], state[8], state[9]
        roll, pitch, _ = euler(e0, e1, e2, e3)
        north, east, down = buf[W + lane], buf[W + L + lane], buf[W + 2 * L + lane]
        x, y, z = to_body(e0, e1, e2, e3, north, east, down)
        u, v, w = state[3] - x, state[4] - y, state[5] - z
        speed = np.sqrt(u * u + v * v + w * w)
        sine, _ = sin_cos(2.0 * pi * t_s / buf[T + 2 * L + lane])
        elevator = PITCH_RATE * state[11] - PITCH * (buf[T + 3 * L + lane] - pitch)
        aileron = ROLL * (buf[T + L + lane] * sine - roll) - ROLL_RATE * state[10]
        throttle = buf[O + 3 * L + lane] + SPEED * (buf[T + 4 * L + lane] - speed)
        elevator = buf[O + lane] + (min(THROW_RAD, max(-THROW_RAD, elevator)) if on else 0.0)
        aileron = buf[O + L + lane] + (min(THROW_RAD, max(-THROW_RAD, aileron)) if on else 0.0)
        buf[C + lane] = elevator
        buf[C + L + lane] = aileron
        buf[C + 2 * L + lane] = buf[O + 2 * L + lane]
        buf[C + 3 * L + lane] = min(1.0, max(0.0, throttle)) if on else buf[O + 3 * L + lane]
