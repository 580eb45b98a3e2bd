"""The newest epoch of a graph in the words of `analysis.results`."""

import math

import msgspec
import numpy as np

from analysis.fusion.frame import quaternion
from analysis.fusion.graph import Graph
from analysis.gnss import geodetic, ned_axes
from analysis.results import FusedState
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled

UNKNOWN_DEG = (180.0, 180.0, 180.0)


def fused_state(graph: Graph, name: str, weights: dict[str, float], reason: str) -> FusedState:
    """Position, velocity and attitude with sigmas; those of position and velocity north, east,
    down, those of attitude about the body's axes."""
    node, p, frame = graph.node, graph.covariance, graph.frame
    rows = _rows(
        node.pose.matrix(), node.velocity, p, frame.anchor_m, frame.axes, graph.slow_m2
    ).tolist()
    return FusedState(
        t_s=node.t_us * 1e-6,
        t_us=node.t_us,
        name=name,
        position_ecef_m=tuple(rows[0]),
        velocity_ned_mps=tuple(rows[1]),
        q_nb=quaternion(np.array(rows[5:])),
        position_sigma_m=tuple(rows[2]),
        velocity_sigma_mps=tuple(rows[3]),
        attitude_sigma_deg=tuple(rows[4]) if graph.aligned else UNKNOWN_DEG,
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


@compiled
def _rows(
    pose: Vector, velocity: Vector, p: Vector, anchor_m: Vector, axes: Vector, slow_m2: Vector
) -> Vector:
    """Rows (8, 3): position in ECEF; velocity north, east, down; sigmas of position and velocity,
    and of attitude in degrees; the rotation from body to north, east, down."""
    out = np.zeros((8, 3))
    for i in range(3):
        out[0, i] = anchor_m[i]
        for k in range(3):
            out[0, i] += axes[k, i] * pose[k, 3]
    lat, lon, _ = geodetic(out[0])
    ned = ned_axes(lat, lon)
    to_ned = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                to_ned[i, j] += ned[i, k] * axes[j, k]
    for i in range(3):
        for j in range(3):
            out[1, i] += to_ned[i, j] * velocity[j]
            for k in range(3):
                out[5 + i, j] += to_ned[i, k] * pose[k, j]
    for i in range(3):
        where = speed = 0.0
        for j in range(3):
            for k in range(3):
                where += out[5 + i, j] * p[3 + j, 3 + k] * out[5 + i, k]
                where += ned[i, j] * slow_m2[j, k] * ned[i, k]
                speed += to_ned[i, j] * p[6 + j, 6 + k] * to_ned[i, k]
        out[2, i], out[3, i] = math.sqrt(where), math.sqrt(speed)
        out[4, i] = math.degrees(math.sqrt(p[i, i]))
    return out
