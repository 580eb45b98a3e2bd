"""Detects stream anomalies: silence, repetition, a wrong rate, frozen or jumping timestamps.

A sensor is faulty, whatever its values, if it falls silent, its samples are sparse or come in
bursts, it repeats itself beyond its own noise and resolution, or its timestamps are wrong. If all
streams pause together, the link was lost. Results are repeated every half second.
"""

from typing import ClassVar

import numpy as np

from analysis.detection.detector_registry import BlockDetector
from analysis.detection.streams.rate_kernel import COLUMNS
from analysis.detection.streams.stream_kernel import (
    BURSTING,
    FROZEN_TIME,
    JUMPED_AHEAD,
    JUMPED_BACK,
    LATE,
    LINK,
    REPEATED,
    REPORTED_US,
    SILENT,
    SPARSE,
    STREAMS,
    StreamAnomalies,
    StreamStates,
    track_streams,
)
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import NEVER_US, WIDTH, Block

REASONS = {
    SILENT: "silent for {:.2f} s",
    REPEATED: "the same value for {:.2f} s",
    FROZEN_TIME: "its timestamp is frozen, {:.2f} s behind",
    JUMPED_AHEAD: "its timestamp jumps {:.2f} s ahead",
    JUMPED_BACK: "its timestamp jumps back by {:.2f} s",
    LATE: "{:.2f} s late",
    SPARSE: "rate is {:.2f} of the usual",
    BURSTING: "{:.0f} samples at once",
}
MOST = 10_000  # results of one block


class StreamDetector(BlockDetector, frozen=True):
    """Tests every stream that has been received; without a `link` a pause of all is no anomaly."""

    channels: ClassVar = frozenset(STREAMS)

    link: bool = True

    def new_state(self) -> StreamStates:
        """No sample has come yet."""
        count = len(STREAMS)
        counts = np.zeros((count, 9), np.int64)
        counts[:, REPORTED_US] = NEVER_US
        return StreamStates(
            counts,
            np.zeros((count, 4)),
            # NaN equals nothing, so the first value is no repetition.
            np.full((count, WIDTH), np.nan),
            np.zeros((count, WIDTH, 3), np.int64),
            np.zeros((count, COLUMNS)),
            np.full((2, 6), NEVER_US),
        )

    def step(
        self, block: Block, state: StreamStates
    ) -> tuple[list[tuple[int, SensorDecision]], StreamStates]:
        """The anomalies of the next samples by row, and the state, which is changed in place."""
        anomalies = StreamAnomalies(
            np.empty((MOST, 4), np.int64), np.empty(MOST), np.zeros(1, np.int64)
        )
        track_streams(block.kind, block.t_us, block.values, state, anomalies)
        count = int(anomalies.filled[0])
        rows = zip(anomalies.rows[:count].tolist(), anomalies.amounts[:count].tolist(), strict=True)
        return [
            (row, _result(t_us, stream, anomaly, amount))
            for (row, t_us, stream, anomaly), amount in rows
            if self.link or stream != LINK
        ], state


def _result(t_us: int, stream: int, anomaly: int, amount: float) -> SensorDecision:
    return pattern_alarm(t_us, STREAMS[stream], REASONS[anomaly].format(amount))
