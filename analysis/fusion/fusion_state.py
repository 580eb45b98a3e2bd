"""State of the fusion step, and its input of one epoch."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from analysis.detection.detector_state import DetectorCore
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.propagation import NO_RUN, add_pending
from analysis.detection.values import Value
from analysis.fusion.graph import Graph
from analysis.fusion.learned_noise import LearnedNoise
from analysis.results import Decision, FusedState, Result
from analysis.samples.block import ImuRun
from analysis.samples.sample import Sample


class FusionEpoch(Value, frozen=True):
    """One epoch: its sample, the detector's results, and the detector's state after it."""

    sample: Sample
    decision: Decision
    results: Sequence[Result]
    core: DetectorCore

    @property
    def motion(self) -> MotionEstimate | None:
        """The detector's filter if it is at this epoch."""
        motion = self.core.motion
        return motion if motion and motion.t_us == self.decision.t_us else None


@dataclass(slots=True)
class FusionState:
    """State of the fusion; changed in place, as GTSAM's smoother in it is.

    `imu` and `pending` are samples for the next epoch, `noise` the noise learned in
    flight. `excluded` and `isolated` were left out of the last epoch. `attitude_lost`: the IMU was
    missing since the attitude was known; `imu_suspect_us`: since when the IMU has been suspicious.
    `notes` are for the next result's reason.
    """

    imu: ImuRun = NO_RUN
    pending: dict[str, Sample] = field(default_factory=dict)
    graph: Graph | None = None
    noise: LearnedNoise = field(default_factory=LearnedNoise)
    excluded: frozenset[str] = frozenset()
    isolated: frozenset[str] = frozenset()
    attitude_lost: bool = False
    imu_suspect_us: int | None = None
    notes: list[str] = field(default_factory=list)
    last: FusedState | None = None

    def add_imu(self, run: ImuRun) -> None:
        """Add IMU samples: those before the graph's newest epoch go into the graph, the rest wait
        for the next epoch."""
        if self.graph is not None and (late := run.t_us <= self.graph.node.t_us).any():
            for t_us, row in zip(run.t_us[late].tolist(), run.values[late], strict=True):
                self.graph.add_late_imu(t_us, row)
            run = ImuRun(run.t_us[~late], run.values[~late])
        self.imu = add_pending(run, self.imu)

    def imu_until(self, until_us: int) -> ImuRun:
        """The samples up to a time, in order of time, each stamp once: late runs may overlap."""
        stamps, first = np.unique(self.imu.t_us, return_index=True)
        end = int(np.searchsorted(stamps, until_us, side="right"))
        return ImuRun(stamps[:end], self.imu.values[first[:end]])

    def drop_imu_until(self, until_us: int) -> None:
        """Drop the samples up to a time."""
        later = self.imu.t_us > until_us
        self.imu = ImuRun(self.imu.t_us[later], self.imu.values[later])
