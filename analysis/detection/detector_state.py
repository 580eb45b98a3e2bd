"""The detector's state, in parts of one concern each; every step returns a new one.

A part is defined in the package that it serves: `ImuStatus` and `BroadcastData` in `filter`,
`Trust` and `EpochMemory` in `isolation`, `ReceiverState` in `receiver`.
"""

from typing import NamedTuple

import msgspec

from analysis.detection.filter.ephemerides import BroadcastData
from analysis.detection.filter.filter_state import ImuStatus, MotionEstimate
from analysis.detection.filter.measurement import EpochObservation
from analysis.detection.filter.propagation import NO_RUN, ImuSegment, imu_segment
from analysis.detection.isolation.epoch_memory import EpochMemory
from analysis.detection.isolation.range_difference import Differences
from analysis.detection.isolation.trust import Trust
from analysis.detection.receiver.receiver_state import ReceiverState
from analysis.detection.values import Value
from analysis.samples.block import ImuRun
from analysis.samples.sample import Vector


class EpochTiming(Value, frozen=True):
    """When epochs come: the last one with usable ranges (None: there was none), the time between
    epochs (0: unknown), and the newest gap that differed from it.

    `before_gap` is the filter as it was before a gap too long to bridge.
    """

    ranges_us: int | None = None
    spacing_us: int = 0
    gap_us: int = 0
    before_gap: MotionEstimate | None = None


class DetectorCore(Value, frozen=True):
    """Everything that an epoch reads and updates; `motion` is the filter (None: not started).

    `differences` are those of each satellite's two ranges; `history` holds the newest epochs, so
    that the filter can be repaired.
    """

    motion: MotionEstimate | None
    broadcast: BroadcastData
    imu: ImuStatus = ImuStatus()
    trust: Trust = Trust()
    memory: EpochMemory = EpochMemory()
    receiver: ReceiverState = ReceiverState()
    timing: EpochTiming = EpochTiming()
    differences: Differences = msgspec.field(default_factory=dict)
    history: "tuple[EpochRecord, ...]" = ()


class EpochRecord(Value, frozen=True, eq=False):
    """A snapshot of one epoch, for a replay: the core before it, its observation, and the IMU's
    samples up to it. Records are equal by identity: what is computed of one is cached by it."""

    t_us: int
    core: DetectorCore
    observation: EpochObservation
    run: ImuRun

    @property
    def segment(self) -> ImuSegment:
        """The IMU's samples since the epoch before."""
        assert self.core.motion is not None
        return imu_segment(self.run, self.core.motion, self.t_us)


class DetectorState(NamedTuple):
    """The core, the IMU's samples since the last epoch, and the newest magnetometer sample (3,)."""

    core: DetectorCore
    pending: ImuRun = NO_RUN
    mag_b: Vector | None = None
