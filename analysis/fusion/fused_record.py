"""The newest epoch of a graph as a `FusedState`."""

from typing import Any

import numpy as np

from analysis.fusion.graph import Graph
from analysis.results import FusedState
from mavproxy_fault.numerics.earth_kernel import local_axes
from mavproxy_fault.numerics.rotations.rotation import quat_from_matrix

UNKNOWN_DEG = (180.0, 180.0, 180.0)


def fused_state(graph: Graph, name: str, weights: dict[str, float], reason: str) -> FusedState:
    """Position, velocity and attitude with sigmas: those of position and velocity north, east,
    down, those of attitude about the body axes."""
    node, frame = graph.node, graph.frame
    pose, p = node.pose.matrix(), graph.covariance
    position = frame.ecef(pose[:3, 3])
    ned = local_axes(position)
    to_ned = ned @ frame.axes.T
    rotation = to_ned @ pose[:3, :3]
    # The graph takes range errors as independent: their lasting part is added.
    position_m2 = rotation @ p[3:6, 3:6] @ rotation.T + ned @ graph.slow_m2 @ ned.T
    velocity_m2 = to_ned @ p[6:9, 6:9] @ to_ned.T
    variances = position_m2.diagonal(), velocity_m2.diagonal(), p.diagonal()[:3]
    position_sigma, velocity_sigma, attitude_sigma = np.sqrt(variances)
    vectors = position, to_ned @ node.velocity, position_sigma, velocity_sigma
    each: list[Any] = [tuple(one.tolist()) for one in (*vectors, np.degrees(attitude_sigma))]
    return FusedState(
        t_us=node.t_us,
        name=name,
        position_ecef_m=each[0],
        velocity_ned_mps=each[1],
        q_nb=tuple(quat_from_matrix(rotation).tolist()),
        position_sigma_m=each[2],
        velocity_sigma_mps=each[3],
        # Before alignment the graph holds its attitude fixed; its small sigma is meaningless.
        attitude_sigma_deg=each[4] if graph.aligned else UNKNOWN_DEG,
        weights=weights,
        reason=reason,
    )
