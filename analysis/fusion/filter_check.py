"""Consistency check of the graph against the detector's filter, which has the same data.

The graph keeps a window and weights sources by the noise learned in flight, so it may differ from
the filter, but not by more than both covariances allow, and its own covariance must not be much
larger. Where either fails, as when removing a satellite's past leaves the window underdetermined,
the filter's solution is used.

Most of the position error lasts for minutes and is common to both. Where they differ by much less
than that, neither is known to be better, and the filter's position is reported, so that the fusion
cannot be worse. It is also reported where only the motion model connects the graph's epochs: the
graph trusts ranges less than the filter does and would lag in every turn.
"""

import math

import msgspec
import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import R
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.fusion.factors.factor_weights import residual_weight
from analysis.fusion.graph import Graph
from analysis.results import Decision, FusedState
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import (
    invert_positive_definite,
    multiply_matrices,
    multiply_vector,
    transpose_matrix,
)

P_CONTRADICTION = 1e-4  # fault-free flights and walks reach 17; the threshold of 3 dof is 21
MAX_SIGMA_RATIO = (
    2.0  # of the graph's `correlation`, by which its initial sigma exceeds the filter's
)
POSE_SHIFT = 3  # offset of the translation in a pose's errors
DISTANCE_M, STATISTIC, SIGMA_RATIO = 0, 1, 2
# Of the filter's sigma, which includes lasting errors.
USE_FILTER_BELOW, USE_GRAPH_ABOVE = 0.25, 0.5
FILTER = "filter"  # the source's name among the weights


def filter_contradiction(graph: Graph, motion: MotionEstimate | None, correlation: float) -> str:
    """Why the filter's solution must replace the graph's; empty if it need not."""
    if motion is None:
        return ""
    frame = graph.frame
    compared = _compare(
        graph.node.pose.matrix(),
        graph.covariance,
        frame.local(motion.x[R : R + 3]),
        motion.p[R : R + 3, R : R + 3],
        frame.axes,
    )
    distance_m, q, ratio = compared.tolist()
    # Written so that NaN counts as a contradiction, here and below.
    if not q <= chi_square_threshold(3, P_CONTRADICTION):
        return f"the graph was {distance_m:.1f} m ({math.sqrt(q):.1f} sigmas) from the filter"
    if not ratio <= MAX_SIGMA_RATIO * correlation:
        return f"the graph's sigma was {ratio:.0f} times the filter's"
    return ""


def blend_with_filter(fused: FusedState, decision: Decision, tied: bool = True) -> FusedState:
    """The fused state with the filter's position where the two are indistinguishable or the epoch
    is not `tied` to the last, blending smoothly into the graph's; the weight `filter` is the
    filter's share."""
    if decision.position_ecef_m is None or decision.position_sigma_m is None:
        return fused
    ours, theirs = np.array(fused.position_ecef_m), np.array(decision.position_ecef_m)
    off = math.dist(ours, theirs) / math.hypot(*decision.position_sigma_m)
    share = residual_weight(off, USE_FILTER_BELOW, USE_GRAPH_ABOVE) if tied else 1.0
    x, y, z = (ours + share * (theirs - ours)).tolist()
    return msgspec.structs.replace(
        fused, position_ecef_m=(x, y, z), weights=fused.weights | {FILTER: share}
    )


@compiled
def _compare(pose: Vector, p: Vector, filter_m: Vector, filter_p: Vector, axes: Vector) -> Vector:
    """Distance in m, its normalised square, and the ratio of the graph's sigma to the filter's.

    `pose` (4, 4) and `p` (9, 9) are the graph's, in its own frame and in body axes; `filter_m` (3,)
    is in that frame, `filter_p` (3, 3) in ECEF, `axes` (3, 3) the frame's rows.
    """
    # Contiguous copies: products of slices would be compiled separately.
    rot = pose[:3, :3].copy()
    shift = p[POSE_SHIFT : POSE_SHIFT + 3, POSE_SHIFT : POSE_SHIFT + 3].copy()
    own = multiply_matrices(multiply_matrices(rot, shift), transpose_matrix(rot))
    known = multiply_matrices(multiply_matrices(axes, filter_p.copy()), transpose_matrix(axes))
    off, both = np.empty(3), np.empty((3, 3))
    for i in range(3):
        off[i] = pose[i, 3] - filter_m[i]
        for k in range(3):
            both[i, k] = own[i, k] + known[i, k]
    weighted, out = multiply_vector(invert_positive_definite(both), off), np.zeros(3)
    graph_m2 = filter_m2 = 0.0
    for i in range(3):
        out[DISTANCE_M] += off[i] ** 2
        out[STATISTIC] += off[i] * weighted[i]
        graph_m2 += own[i, i]
        filter_m2 += known[i, i]
    out[DISTANCE_M] = math.sqrt(out[DISTANCE_M])
    out[SIGMA_RATIO] = math.sqrt(graph_m2 / filter_m2)
    return out
