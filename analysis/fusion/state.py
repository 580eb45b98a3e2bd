"""What moves in the fusion step, and what it is told of an epoch."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from analysis.fdi.core import Core, Record
from analysis.fdi.motion import PENDING_MAX
from analysis.fdi.state import Motion
from analysis.fusion.beginning import Node
from analysis.fusion.frame import Frame
from analysis.fusion.graph import Graph
from analysis.fusion.learnt import Learnt
from analysis.fusion.other import Others
from analysis.results import Decision, FusedState, Result
from analysis.samples import ImuSample, Sample, Vector


@dataclass(frozen=True, slots=True)
class Now:
    """One epoch: the sample that made it, what the detector said, and its state after it."""

    sample: Sample
    decision: Decision
    results: Sequence[Result]
    core: Core

    @property
    def motion(self) -> Motion | None:
        """The detector's filter if it is at this epoch."""
        motion = self.core.motion
        return motion if motion and motion.t_us == self.decision.t_us else None

    @property
    def record(self) -> Record | None:
        """What the detector keeps of this epoch, where it does."""
        history = self.core.history
        return history[-1] if history and history[-1].t_us == self.decision.t_us else None


class Good(NamedTuple):
    """What a graph was after its last commit."""

    frame: Frame
    node: Node
    covariance: Vector
    aligned: bool


@dataclass(slots=True)
class FusionState:
    """What moves; changed in place, as the graph in it must be.

    `imu` and `waiting` are samples for the next epoch and `run` the IMU up to the newest one.
    `learnt` is what the flight has shown of its noise. `excluded` and `isolated` are what was left
    out there, `lost` says that the graph has missed the IMU since it knew its attitude,
    `suspect_us` since when the IMU has been suspicious. `sky` are the satellites that the slow
    covariance is of, and when; `notes` are for the next result's reason.
    """

    imu: deque[ImuSample] = field(default_factory=lambda: deque(maxlen=PENDING_MAX))
    run: list[ImuSample] = field(default_factory=list)
    waiting: dict[str, Sample] = field(default_factory=dict)
    graph: Graph | None = None
    others: Others | None = None
    learnt: Learnt = field(default_factory=Learnt)
    good: Good | None = None
    excluded: frozenset[str] = frozenset()
    isolated: frozenset[str] = frozenset()
    lost: bool = False
    suspect_us: int | None = None
    sky: tuple[object, ...] = ()
    notes: list[str] = field(default_factory=list)
    last: FusedState | None = None
