"""Feedback: the smoother's newest epoch replaces the state of the detector's filter."""

import numpy as np

from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.inertial import (
    BA,
    BG,
    CLOCK,
    DRIFT,
    ERROR_SIZE,
    ISB,
    PSI,
    X_ISB,
    X_Q,
    R,
    V,
)
from analysis.fusion.graph import Graph
from analysis.fusion.graph_start import navigation_state
from analysis.fusion.window import variable_key
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

NODE_ERRORS = 17  # of a node: rotation, translation (body axes), velocity, biases, clock, drift


def feed_back(core: DetectorCore, graph: Graph | None) -> DetectorCore:
    """The detector's state with the filter state and covariance of the graph.

    Both must be aligned and at the same epoch, else nothing changes; inter-system biases stay the
    filter's own.
    """
    motion = core.motion
    if motion is None or graph is None or not (motion.inertial and graph.aligned):
        return core
    node = graph.node
    if motion.t_us != node.t_us:
        return core
    x = navigation_state(graph.frame, node, motion.x[X_ISB:])
    names = [variable_key(letter, node.epoch) for letter in "xvbc"]
    to_filter = _to_filter(graph.frame.axes.T, rotation_matrix(x[X_Q : X_Q + 4]))
    p = to_filter @ graph.window.covariance(names) @ to_filter.T
    p[ISB:, ISB:] = motion.p[ISB:, ISB:]
    # Rounding leaves the product a little asymmetric; a filter expects symmetry.
    return core._replace(motion=motion._replace(x=x, p=0.5 * (p + p.T)))


def _to_filter(to_ecef: Vector, rot_eb: Vector) -> Vector:
    """Jacobian (20, 17) of the filter's errors with respect to those of a node."""
    jacobian = np.zeros((ERROR_SIZE, NODE_ERRORS))
    jacobian[PSI : PSI + 3, 0:3] = rot_eb
    jacobian[R : R + 3, 3:6] = rot_eb
    jacobian[V : V + 3, 6:9] = to_ecef
    jacobian[BA : BA + 3, 9:12] = np.eye(3)
    jacobian[BG : BG + 3, 12:15] = np.eye(3)
    jacobian[CLOCK, 15] = jacobian[DRIFT, 16] = 1.0
    return jacobian
