"""The newest epoch of a graph as a `FusedState`."""

import math
from typing import Any

import msgspec
import numpy as np

from analysis.fusion.graph import Graph
from analysis.fusion.local_frame import quaternion_of_matrix
from analysis.results import FusedState
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.numerics.linear import multiply_matrices, multiply_vector, transpose_matrix

UNKNOWN_DEG = (180.0, 180.0, 180.0)


def fused_state(graph: Graph, name: str, weights: dict[str, float], reason: str) -> FusedState:
    """Position, velocity and attitude with sigmas: those of position and velocity north, east,
    down, those of attitude about the body axes."""
    node, frame = graph.node, graph.frame
    rows = _state_numbers(
        node.pose.matrix(),
        node.velocity,
        graph.covariance,
        frame.anchor_m,
        frame.axes,
        graph.slow_m2,
    )
    numbers = rows.tolist()
    each: list[Any] = [tuple(numbers[at : at + 3]) for at in range(0, 15, 3)]
    return FusedState(
        t_us=node.t_us,
        name=name,
        position_ecef_m=each[0],
        velocity_ned_mps=each[1],
        q_nb=tuple(numbers[15:]),
        position_sigma_m=each[2],
        velocity_sigma_mps=each[3],
        # Before alignment the graph holds its attitude fixed; its small sigma is meaningless.
        attitude_sigma_deg=each[4] if graph.aligned else UNKNOWN_DEG,
        weights=weights,
        reason=reason,
    )


def repeat_last_state(last: FusedState, t_us: int, why: str) -> FusedState:
    """Repeat the last good state, where there is no other."""
    return msgspec.structs.replace(
        last,
        t_us=t_us,
        weights={},  # nothing was used
        reason=f"the graph failed ({why}); this is the last good state",
    )


@compiled
def _state_numbers(
    pose: Vector, velocity: Vector, p: Vector, anchor_m: Vector, axes: Vector, slow_m2: Vector
) -> Vector:
    """Numbers (19,): position in ECEF; velocity north, east, down; sigmas of position and velocity,
    and of attitude in degrees; the quaternion from body to north, east, down."""
    out = np.empty(19)
    for i in range(3):
        out[i] = anchor_m[i]
        for k in range(3):
            out[i] += axes[k, i] * pose[k, 3]
    lat, lon, _ = geodetic_position(out[0:3])
    ned = ned_axes(lat, lon)
    to_ned = multiply_matrices(ned, transpose_matrix(axes))
    rotation = multiply_matrices(to_ned, pose[0:3, 0:3])
    speed, q = multiply_vector(to_ned, velocity), quaternion_of_matrix(rotation)
    position, lasting = _variances(rotation, p[3:6, 3:6]), _variances(ned, slow_m2)
    velocity_variance = _variances(to_ned, p[6:9, 6:9])
    for i in range(3):
        out[3 + i] = speed[i]
        # The graph takes range errors as independent: their lasting part is added.
        out[6 + i] = math.sqrt(position[i] + lasting[i])
        out[9 + i] = math.sqrt(velocity_variance[i])
        out[12 + i] = math.degrees(math.sqrt(p[i, i]))
    for i in range(4):
        out[15 + i] = q[i]
    return out


@compiled
def _variances(a: Vector, p: Vector) -> Vector:
    """Diagonal (3,) of a p a'."""
    out, ap = np.zeros(3), multiply_matrices(a, p)
    for i in range(3):
        for k in range(3):
            out[i] += ap[i, k] * a[i, k]
    return out
