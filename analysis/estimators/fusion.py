"""The project's own fusion: the detector's verdicts, GTSAM's smoother, and the gyro in between.

A smoothed attitude comes with each GNSS epoch or GPS fix; from there the gyro, less the bias that
the graph holds, carries it on. Before the graph begins the prior is carried on.
"""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.epochs import ImuSample, Sample
from analysis.estimators.base import MAX_GAP_S, AttitudeEstimate, Prior
from analysis.estimators.rotations import turned
from analysis.fdi import DetectorConfig
from analysis.fusion.config import FusionConfig
from analysis.fusion.smoother import Fusion
from analysis.reference import References
from analysis.results import FusedState

Vector = NDArray[np.float64]


class SmootherState(NamedTuple):
    """q_nb (4,) and gyro bias (3,) in rad/s now; the states of detector and smoother."""

    t_us: int
    q_nb: Vector
    bias_rps: Vector
    detector: Any
    fusion: Any


@dataclass(frozen=True)
class Smoother:
    """Fusion and detector as a scenario's `monitor` section switches them on."""

    fusion: Fusion = field(default_factory=lambda: Fusion(FusionConfig(), DetectorConfig()))
    detector: References = field(default_factory=lambda: References(DetectorConfig()))

    def start(self, prior: Prior) -> SmootherState:
        """The prior's attitude; the graph finds its own."""
        return SmootherState(
            prior.t_us,
            prior.q_nb,
            np.zeros(3),
            self.detector.new_state(),
            self.fusion.new_state(),
        )

    def update(
        self, reading: Sample, state: SmootherState
    ) -> tuple[AttitudeEstimate, SmootherState]:
        """The gyro carries on; what the reading let the smoother say replaces it."""
        results, detector = self.detector.step(reading, state.detector)
        fused, fusion = self.fusion.step(reading, results, detector.detector.core, state.fusion)
        t_us, q_nb, bias = state.t_us, state.q_nb, state.bias_rps
        if isinstance(reading, ImuSample):
            dt_s = (reading.t_us - t_us) * 1e-6
            if 0.0 < dt_s <= MAX_GAP_S:
                step = (reading.gyro_b_rps - bias) * dt_s
                q_nb = turned(q_nb, step[0], step[1], step[2])
            t_us = max(reading.t_us, t_us)
        for said in fused:  # before the graph is inertial its attitude means nothing
            if isinstance(said, FusedState) and fusion.graph and fusion.graph.inertial:
                q_nb, bias = np.array(said.q_nb), np.array(fusion.graph.node.bias.gyroscope())
        return (
            AttitudeEstimate(t_us, q_nb),
            SmootherState(t_us, q_nb, bias, detector, fusion),
        )
