"""When everything paused: an IMU that is silent while nobody speaks is not at fault."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from analysis.detection.streams.stream_kernel import NEVER_US, STREAM_OF
from analysis.results import Result, SensorDecision
from analysis.samples.block import Block, Stamps

PAUSE_US = 150_000  # as long as an IMU may be silent
AFTER_PAUSE_US = 1_500_000  # after a pause: until the epoch behind it
IMU_SILENT = "no IMU samples for"  # how the reason of such a finding begins
ABSENCE_REASONS = ("silent for", "comes ", IMU_SILENT)  # and of any who did not come
R = TypeVar("R", bound=Result)
_SHOWS_TIME = (
    np.array(STREAM_OF) != -2
)  # by kind of sample: not broadcasts, nor what has its own time


@dataclass(frozen=True, slots=True)
class PauseState:
    """The newest stamp of any sensor, and the one at which the last pause of all ended."""

    heard_us: int = NEVER_US
    ended_us: int = NEVER_US


@dataclass(frozen=True)
class PauseFilter:
    """A step of the pipeline that takes back what a pause explains."""

    def step(
        self, block: Block, found: list[tuple[int, Result]], state: PauseState
    ) -> tuple[list[tuple[int, Result]], PauseState]:
        """What is left of the findings, each with its row, and the next state."""
        if not len(block.kind):
            return found, state
        ended, state = _pause_ends(block, state)
        return [
            (row, result)
            for row, result in found
            if not _is_silence(result) or result.t_us - ended[row] > AFTER_PAUSE_US
        ], state


def drop_log_gaps(
    found: list[tuple[int, R]], lost_us: Sequence[tuple[int, int]]
) -> list[tuple[int, R]]:
    """What is left of the findings where a log's writer says from when to when it lost records:
    who did not come then may have been there."""
    if not lost_us:
        return found
    return [
        (row, result)
        for row, result in found
        if not (isinstance(result, SensorDecision) and result.reason.startswith(ABSENCE_REASONS))
        or not any(begin <= result.t_us <= end + AFTER_PAUSE_US for begin, end in lost_us)
    ]


def _pause_ends(block: Block, state: PauseState) -> tuple[Stamps, PauseState]:
    """By row (n,) when the last pause of everything ended."""
    speaks = _SHOWS_TIME[block.kind] & (block.t_us > 0)
    stamps = np.where(speaks, block.t_us, NEVER_US)
    newest = np.maximum.accumulate(np.append(state.heard_us, stamps))
    ends = np.where(np.diff(newest) > PAUSE_US, newest[1:], NEVER_US)
    ended = np.maximum(np.maximum.accumulate(ends), state.ended_us)
    return ended, PauseState(int(newest[-1]), int(ended[-1]))


def _is_silence(result: Result) -> bool:
    return isinstance(result, SensorDecision) and result.reason.startswith(IMU_SILENT)
