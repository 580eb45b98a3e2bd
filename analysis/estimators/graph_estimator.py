"""The factor graph as an attitude estimator, for the scores and the search.

It contains the detector and the tests of the other sensors. Between GNSS epochs the gyro, less the
graph's bias, propagates the newest attitude of the graph.
"""

from collections import deque
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import PSI, X_Q, R
from analysis.detection.sensors.sensor_tests import NavigationDetector, NavigationState
from analysis.estimators.estimator import MAX_GAP_S, AttitudeEstimate, Prior
from analysis.fusion.fusion_config import FusionConfig
from analysis.fusion.fusion_state import FusionState
from analysis.fusion.smoother import Fusion
from analysis.results import Decision, FusedState
from analysis.samples.block import split_at_events
from analysis.samples.sample import ImuSample, Sample, Vector
from mavproxy_fault.numerics.earth_kernel import local_axes
from mavproxy_fault.numerics.rotations.rotation import quat_from_matrix
from mavproxy_fault.numerics.rotations.rotation_kernel import rotate_attitude, rotation_matrix

PRIOR_SIGMA_RAD = 0.05  # sigma of the first attitude, as in `Ekf.start_sigma`


@dataclass(slots=True)
class FusedAttitudeState:
    """State, changed in place: detector and graph, attitude (4,) and its time, gyro bias (3,), the
    rates (time, rate (3,), length in s) since the last epoch."""

    detector: NavigationState
    fusion: FusionState
    q_nb: Vector
    t_us: int
    bias_rps: Vector = field(default_factory=lambda: np.zeros(3))
    rates: deque[tuple[int, Vector, float]] = field(default_factory=deque)


@dataclass(frozen=True)
class FusedAttitude:
    """An `Estimator`; it needs an IMU and a receiver's positions or raw ranges."""

    config: FusionConfig = field(default_factory=FusionConfig)
    detector: DetectorConfig = field(default_factory=DetectorConfig)

    @cached_property
    def _references(self) -> NavigationDetector:
        return NavigationDetector(self.detector)

    @cached_property
    def _fusion(self) -> Fusion:
        return Fusion(self.config, self.detector)

    def start(self, prior: Prior) -> FusedAttitudeState:
        """The state before the first reading."""
        return FusedAttitudeState(
            self._references.new_state(),
            self._fusion.new_state(),
            np.array(prior.q_nb, dtype=float),
            prior.t_us,
        )

    def update(
        self, reading: Sample, state: FusedAttitudeState
    ) -> tuple[AttitudeEstimate, FusedAttitudeState]:
        """The attitude after one reading; the state is changed in place."""
        if isinstance(reading, ImuSample) and reading.t_us > state.t_us:
            dt_s = (reading.t_us - state.t_us) * 1e-6
            if dt_s <= MAX_GAP_S:
                state.rates.append((reading.t_us, reading.gyro_b_rps, dt_s))
                state.q_nb = _rotate_by(state.q_nb, reading.gyro_b_rps - state.bias_rps, dt_s)
            state.t_us = reading.t_us
        (piece,) = split_at_events(reading)
        results, state.detector = self._references.step_piece(piece, state.detector)
        decision = next((result for result in results if isinstance(result, Decision)), None)
        motion = state.detector.detector.core.motion
        if decision is not None and decision.mode == "start" and motion is not None:
            self._align_detector(motion, state)
        core = state.detector.detector.core
        fused, state.fusion = self._fusion.step(piece, results, core, state.fusion)
        for result in fused:
            if isinstance(result, FusedState):
                self._adopt(result, state)
        return AttitudeEstimate(max(reading.t_us, state.t_us), state.q_nb), state

    @staticmethod
    def _align_detector(motion: MotionEstimate, state: FusedAttitudeState) -> None:
        """Initialise the attitude of the detector's filter with that of this estimator."""
        x, p = motion.x.copy(), motion.p.copy()
        axes = local_axes(x[R : R + 3])
        x[X_Q : X_Q + 4] = quat_from_matrix(axes.T @ rotation_matrix(state.q_nb))
        # The prior attitude is not correlated with the other errors.
        p[PSI : PSI + 3, :] = p[:, PSI : PSI + 3] = 0.0
        p[PSI : PSI + 3, PSI : PSI + 3] = PRIOR_SIGMA_RAD**2 * np.eye(3)
        inner = state.detector.detector
        core = inner.core._replace(motion=motion._replace(x=x, p=p, inertial=True))
        state.detector = replace(state.detector, detector=inner._replace(core=core))

    @staticmethod
    def _adopt(fused: FusedState, state: FusedAttitudeState) -> None:
        """Adopt the graph's attitude, propagated from its epoch to the newest IMU sample."""
        graph = state.fusion.graph
        # The graph has used these already; the rest propagates its attitude to now.
        while state.rates and state.rates[0][0] <= fused.t_us:
            state.rates.popleft()
        if graph is None or not graph.aligned:
            return
        state.bias_rps = graph.node.bias.gyroscope()
        q_nb = np.array(fused.q_nb)
        for _, rate, dt_s in state.rates:
            q_nb = _rotate_by(q_nb, rate - state.bias_rps, dt_s)
        state.q_nb = q_nb


def _rotate_by(q_nb: Vector, rate_rps: Vector, dt_s: float) -> Vector:
    rotvec = rate_rps * dt_s
    return np.asarray(rotate_attitude(q_nb, float(rotvec[0]), float(rotvec[1]), float(rotvec[2])))
