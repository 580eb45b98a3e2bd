"""The filter does without an IMU that others have found wrong.

Two IMUs that disagree, one that stands still, or one that turns otherwise than the compass are
told within a second or two, from what they measure alone. What the filter made of such an IMU
would be held against the receiver for a minute, long after the IMU is well again.
"""

from collections.abc import Iterable, Sequence

import msgspec
import numpy as np

from analysis.detection.streams.pause_filter import IMU_SILENT
from analysis.results import Result, SensorDecision
from analysis.samples.block import IMU, Block, Indices, Stamps

HELD_US = 1_500_000  # after an alarm, which is repeated more often while it lasts
STREAM_SILENT = "silent for"  # how the reason of a silent stream begins
HELD_OUT = "the IMU is found wrong by others"
NEVER_US = -(1 << 62)


def hold_out_until(
    block: Block, troubles: Iterable[tuple[int, SensorDecision]], before_us: int
) -> Stamps:
    """Until when the IMU is suspected, by row (n,): by troubles of a block, and from `before_us` on
    by those of the past."""
    until = np.full(len(block.kind), before_us)
    for row, result in troubles:
        alone = result.sensor == "imu" and result.suspect in ("", "imu")
        # One that is silent gives nothing to hold out.
        if alone and result.alarm and not result.reason.startswith(STREAM_SILENT):
            until[row + 1 :] = np.maximum(until[row + 1 :], block.t_us[row] + HELD_US)
    return until


def trusted_rows(block: Block, until: Stamps) -> Indices | None:
    """The rows that the filter may use, None for all of them."""
    held = (block.kind == IMU) & (block.t_us < until)
    return np.flatnonzero(~held) if held.any() else None


def withdraw_silence(
    found: Sequence[tuple[int, Result]], until: Stamps
) -> list[tuple[int, Result]]:
    """Results by row, in which an IMU that was left out is not called silent."""
    kept: list[tuple[int, Result]] = []
    for row, result in found:
        if (
            isinstance(result, SensorDecision)
            and result.reason.startswith(IMU_SILENT)
            and result.t_us < until[row] + HELD_US
        ):
            result = msgspec.structs.replace(result, alarm=False, isolated=False, reason=HELD_OUT)
        kept.append((row, result))
    return kept
