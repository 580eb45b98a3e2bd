"""The newest epoch of a graph in the words of `analysis.results`."""

import msgspec
import numpy as np

from analysis.fusion.frame import quaternion
from analysis.fusion.graph import Graph
from analysis.results import FusedState
from analysis.samples import Vector

UNKNOWN_DEG = (180.0, 180.0, 180.0)


def fused_state(graph: Graph, weights: dict[str, float], reason: str) -> FusedState:
    """Position, velocity and attitude with sigmas; those of position and velocity north, east,
    down, those of attitude about the body's axes."""
    node, p = graph.node, graph.covariance
    r_m = node.pose.translation()
    turn = node.pose.rotation()
    to_ned = graph.frame.ned_from_local(r_m)
    body = to_ned @ turn.matrix()
    to_ned_ecef = to_ned @ graph.frame.axes
    position = body @ p[3:6, 3:6] @ body.T + to_ned_ecef @ graph.slow_m2 @ to_ned_ecef.T
    speed = to_ned @ p[6:, 6:] @ to_ned.T
    return FusedState(
        t_s=node.t_us * 1e-6,
        t_us=node.t_us,
        position_ecef_m=_triple(graph.frame.ecef(r_m)),
        velocity_ned_mps=_triple(to_ned @ node.velocity),
        q_nb=quaternion(body),
        position_sigma_m=_triple(np.sqrt(np.diag(position))),
        velocity_sigma_mps=_triple(np.sqrt(np.diag(speed))),
        attitude_sigma_deg=_triple(np.degrees(np.sqrt(np.diag(p)[:3])))
        if graph.aligned
        else UNKNOWN_DEG,
        weights=weights,
        reason=reason,
    )


def gap(last: FusedState, t_us: int, why: str) -> FusedState:
    """The last good state once more, where there is no other."""
    return msgspec.structs.replace(
        last,
        t_s=t_us * 1e-6,
        t_us=t_us,
        weights={},
        reason=f"the graph failed ({why}); this is the last good state",
    )


def _triple(values: Vector) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
