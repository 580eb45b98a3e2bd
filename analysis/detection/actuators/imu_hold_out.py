"""Keeps an IMU that other detectors found faulty out of the navigation filter (docs/watches.md)."""

from collections.abc import Iterable, Sequence

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from analysis.detection.detector_registry import ENDED_US
from analysis.detection.streams.pause_filter import AFTER_PAUSE_US, IMU_SILENT
from analysis.results import Result, SensorDecision
from analysis.samples.block import IMU, Block, Stamps

STREAM_SILENT = "silent for"  # prefix of the reason of a silent stream
HELD_OUT = "the IMU is held out: other detectors found it faulty"


def hold_out_until(
    block: Block, alarms: Iterable[tuple[int, SensorDecision]], before_us: int
) -> Stamps:
    """Until when the IMU is held out, by row (n,): from `before_us` and a block's alarms."""
    until = np.full(len(block.kind), before_us)
    for row, result in alarms:
        alone = result.sensor == "imu" and result.suspect in ("", "imu")
        # A silent IMU has no samples to hold out.
        if alone and result.alarm and not result.reason.startswith(STREAM_SILENT):
            until[row + 1 :] = np.maximum(until[row + 1 :], block.t_us[row] + ENDED_US)
    return until


def trusted_rows(block: Block, until: Stamps) -> NDArray[np.bool_]:
    """Mask (n,) of the rows that the filter may use."""
    return np.asarray((block.kind != IMU) | (block.t_us >= until))


def withdraw_silence(
    results: Sequence[tuple[int, Result]], until: Stamps, paused: Stamps
) -> list[tuple[int, Result]]:
    """The results without alarms of an IMU that is silent because it is held out, or because
    everything had `paused` until then; both by row (n,)."""
    changed: list[tuple[int, Result]] = []
    for row, result in results:
        if isinstance(result, SensorDecision) and result.reason.startswith(IMU_SILENT):
            if result.t_us - paused[row] <= AFTER_PAUSE_US:
                continue
            if result.t_us < until[row] + ENDED_US:
                result = replace(result, alarm=False, isolated=False, reason=HELD_OUT)
        changed.append((row, result))
    return changed
