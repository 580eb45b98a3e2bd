"""Initial state of a graph, from the detector's filter."""

import math
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import (
    BA,
    BG,
    CLOCK,
    DRIFT,
    PSI,
    X_BA,
    X_BG,
    X_CLOCK,
    X_DRIFT,
    X_ISB,
    X_Q,
    X_SIZE,
    R,
    V,
)
from analysis.detection.values import Value
from analysis.fusion.factors.unary_factors import NO_CLOCK
from analysis.fusion.local_frame import LocalFrame, frame_at
from analysis.fusion.window import variable_key
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.rotations.rotation import quat_from_matrix
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

ClockState = tuple[float, float]  # clock in m, drift in m/s
MIN_VARIANCE = 1e-12  # keeps a covariance positive definite
FIXED_ATTITUDE_RAD = 0.1  # chosen: an unknown attitude must not drift while nothing observes it
UNCERTAIN_POSITION_M = 20.0  # above this sigma the first epoch's ranges are attached and QR is used


class Node(Value, frozen=True):
    """An epoch and its estimate in the graph's frame."""

    epoch: int
    t_us: int
    pose: Any
    velocity: Vector
    bias: Any
    clock: ClockState


@dataclass(frozen=True, slots=True)
class GraphStart:
    """The first node with its covariances: pose (6, 6), rotation then translation in body axes,
    velocity (3, 3) in the frame's, bias (6, 6), and sigmas (2,) of clock and drift.

    `aligned`: its attitude is known.
    """

    frame: LocalFrame
    node: Node
    pose_p: Vector
    velocity_p: Vector
    bias_p: Vector
    clock_sigma: Vector
    aligned: bool

    @property
    def uncertain(self) -> bool:
        """Whether the position needs more than priors."""
        return math.sqrt(np.trace(self.pose_p[3:, 3:])) > UNCERTAIN_POSITION_M

    def priors(self) -> list[Any]:
        """The prior factors of the first node."""
        node, gaussian = self.node, gtsam.noiseModel.Gaussian.Covariance
        kinds: tuple[tuple[Any, str, Any, Vector], ...] = (
            (gtsam.PriorFactorPose3, "x", node.pose, self.pose_p),
            (gtsam.PriorFactorPoint3, "v", node.velocity, self.velocity_p),
            (gtsam.PriorFactorConstantBias, "b", node.bias, self.bias_p),
            (gtsam.PriorFactorVector, "c", NO_CLOCK, np.diag(self.clock_sigma**2)),
        )
        return [
            kind(
                variable_key(letter, node.epoch), value, gaussian(p + MIN_VARIANCE * np.eye(len(p)))
            )
            for kind, letter, value, p in kinds
        ]


def first_guess(node: Node) -> Any:
    """A node as GTSAM's values; its clock is zero, the graph's reference."""
    values = gtsam.Values()
    for letter, value in zip("xvbc", (node.pose, node.velocity, node.bias, NO_CLOCK), strict=True):
        values.insert(variable_key(letter, node.epoch), value)
    return values


def start_from_filter(motion: MotionEstimate, correlation: float) -> GraphStart:
    """The detector's filter; the sigmas of position and clock are multiplied by `correlation`."""
    x, p = motion.x, motion.p
    frame = frame_at(x[R : R + 3], motion.t_us)
    rot = frame.axes @ rotation_matrix(x[X_Q : X_Q + 4])
    to_body = rot.T @ frame.axes
    both = np.zeros((6, 6))
    # GTSAM's pose errors are in body axes, the filter's in ECEF.
    both[:3, :3] = both[3:, 3:] = to_body
    states = [*range(PSI, PSI + 3), *range(R, R + 3)]
    widen = np.diag([1.0] * 3 + [correlation] * 3)
    pose_p = widen @ both @ p[np.ix_(states, states)] @ both.T @ widen
    if not motion.inertial:  # nothing observes it, so it must not drift
        pose_p[:3, :] = pose_p[:, :3] = 0.0
        pose_p[:3, :3] = FIXED_ATTITUDE_RAD**2 * np.eye(3)
    biases = [*range(BA, BA + 3), *range(BG, BG + 3)]
    node = Node(
        0,
        motion.t_us,
        gtsam.Pose3(gtsam.Rot3(rot), np.zeros(3)),
        frame.axes @ x[V : V + 3],
        gtsam.imuBias.ConstantBias(x[X_BA : X_BA + 3], x[X_BG : X_BG + 3]),
        (float(x[X_CLOCK]), float(x[X_DRIFT])),
    )
    return GraphStart(
        frame,
        node,
        pose_p,
        frame.axes @ p[V : V + 3, V : V + 3] @ frame.axes.T,
        p[np.ix_(biases, biases)],
        # Range errors are correlated over epochs: the filter's clock sigma is too small.
        correlation * np.sqrt(p[[CLOCK, DRIFT], [CLOCK, DRIFT]] + 1e-4),
        motion.inertial,
    )


def attitude_in_frame(frame: LocalFrame, motion: MotionEstimate) -> tuple[Any, Vector]:
    """The filter's attitude in a frame, with its covariance (3, 3) in body axes."""
    rot = frame.axes @ rotation_matrix(motion.x[X_Q : X_Q + 4])
    to_body = rot.T @ frame.axes
    p = to_body @ motion.p[PSI : PSI + 3, PSI : PSI + 3] @ to_body.T
    return gtsam.Rot3(rot), p + MIN_VARIANCE * np.eye(3)


def navigation_state(frame: LocalFrame, node: Node, isb_m: Vector) -> Vector:
    """A node as the state x (21,) of the detector's filter."""
    x = np.zeros(X_SIZE)
    x[R : R + 3] = frame.ecef(node.pose.translation())
    x[V : V + 3] = frame.axes.T @ node.velocity
    x[X_Q : X_Q + 4] = quat_from_matrix(frame.axes.T @ node.pose.rotation().matrix())
    x[X_BG : X_BG + 3] = node.bias.gyroscope()
    x[X_BA : X_BA + 3] = node.bias.accelerometer()
    x[X_CLOCK], x[X_DRIFT] = node.clock
    x[X_ISB:] = isb_m
    return x
