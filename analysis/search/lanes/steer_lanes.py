"""A mission over lanes; a lane without one flies its controls as they are."""

import numpy as np

from analysis.search.lanes import rows
from analysis.search.lanes.lane_state import Buffer, four_at, state_at, three_at
from analysis.search.lanes.wide import wide
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body
from mavproxy_fault.numerics.rotations.rotation_lanes import euler_of_quaternion
from simvehicle.vehicles.fixedwing.weave_kernel import WeaveFeedback, weave_controls

L = rows.LANES
C, O, T, W = rows.CONTROL * L, rows.OPEN_LOOP * L, rows.MISSION * L, rows.WIND * L  # noqa: E741


@compiled
def steer(buf: Buffer, t_s: float) -> None:
    """CONTROL from OPEN_LOOP and, where there is a mission, feedback."""
    wide()
    for lane in range(L):
        state = state_at(buf, lane)
        _, _, _, u, v, w, e0, e1, e2, e3, p, q, _ = state
        roll, pitch, _ = euler_of_quaternion(e0, e1, e2, e3)
        north, east, down = three_at(buf, W, lane)
        x, y, z = to_body(e0, e1, e2, e3, north, east, down)
        u, v, w = u - x, v - y, w - z
        speed = np.sqrt(u * u + v * v + w * w)
        aim, open_loop = four_at(buf, T + L, lane), four_at(buf, O, lane)
        woven = weave_controls(WeaveFeedback(roll, pitch, p, q, speed), aim, open_loop, t_s)
        on = buf[T + lane] > 0.5
        for i in range(4):
            buf[C + i * L + lane] = woven[i] if on else open_loop[i]
