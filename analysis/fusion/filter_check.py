"""Consistency check of the graph against the detector's filter, which has the same data.

Where they differ by more than both covariances allow, or the graph's covariance is much larger, the
filter's solution is used; where they hardly differ, or only the motion model connects the epochs,
the filter's position (docs/fusion.md).
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
from mavproxy_fault.numerics.linear import invert_positive_definite

P_CONTRADICTION = 1e-4  # fault-free flights and walks reach 17; the threshold of 3 dof is 21
MAX_SIGMA_RATIO = (
    2.0  # of the graph's `correlation`, by which its initial sigma exceeds the filter's
)
POSE_SHIFT = 3  # offset of the translation in a pose's errors
# Of the filter's sigma, which includes lasting errors.
USE_FILTER_BELOW, USE_GRAPH_ABOVE = 0.25, 0.5
FILTER = "filter"  # the source's name among the weights


def filter_contradiction(graph: Graph, motion: MotionEstimate | None, correlation: float) -> str:
    """Why the filter's solution must replace the graph's; empty if it need not."""
    if motion is None:
        return ""
    frame = graph.frame
    pose, shift = graph.node.pose.matrix(), slice(POSE_SHIFT, POSE_SHIFT + 3)
    rot, off = pose[:3, :3], pose[:3, 3] - frame.local(motion.x[R : R + 3])
    # The graph's covariance is in body axes, the filter's in ECEF.
    own = rot @ graph.covariance[shift, shift] @ rot.T
    known = frame.axes @ motion.p[R : R + 3, R : R + 3] @ frame.axes.T
    q = off @ invert_positive_definite(own + known) @ off
    distance_m, ratio = math.hypot(*off), math.sqrt(np.trace(own) / np.trace(known))
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
