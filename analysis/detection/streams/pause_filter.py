"""Which silences a pause explains: of everything, where the IMU is not at fault, or of a logger."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from analysis.detection.streams.stream_detector import SHOWS_TIME
from analysis.results import Result, SensorDecision
from analysis.samples.block import NEVER_US, Block, Stamps

PAUSE_US = 150_000  # as long as an IMU may be silent
AFTER_PAUSE_US = 1_500_000  # after a pause: until the next epoch, at 1 Hz
IMU_SILENT = "no IMU samples for"  # prefix of the reason of such a result
ABSENCE_REASONS = ("silent for", "rate is", IMU_SILENT)  # prefixes of the reasons of absent samples
R = TypeVar("R", bound=Result)


@dataclass(slots=True)
class PauseState:
    """The newest stamp of any sensor, and the one at which the last pause ended."""

    newest_us: int = NEVER_US
    ended_us: int = NEVER_US


def track_pauses(block: Block, state: PauseState) -> Stamps:
    """When the last pause of everything ended, by row (n,); the state is changed in place."""
    shows_time = SHOWS_TIME[block.kind] & (block.t_us > 0)
    stamps = np.where(shows_time, block.t_us, NEVER_US)
    newest = np.maximum.accumulate(np.append(state.newest_us, stamps))
    ends = np.where(np.diff(newest) > PAUSE_US, newest[1:], NEVER_US)
    ended: Stamps = np.maximum(np.maximum.accumulate(ends), state.ended_us)
    state.newest_us, state.ended_us = int(newest[-1]), int(ended[-1])
    return ended


def drop_log_gaps(
    results: list[tuple[int, R]], lost_us: Sequence[tuple[int, int]]
) -> list[tuple[int, R]]:
    """The results without those about samples that a log's writer may have lost."""
    if not lost_us:
        return results
    return [
        (row, result)
        for row, result in results
        if not (isinstance(result, SensorDecision) and result.reason.startswith(ABSENCE_REASONS))
        or not any(begin <= result.t_us <= end + AFTER_PAUSE_US for begin, end in lost_us)
    ]
