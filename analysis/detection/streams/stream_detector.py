"""Every stream that once came is watched: silence, repetition, rate, stamps that stand or leap.

A sensor that falls silent, comes too seldom or in bursts, repeats itself against its own noise and
resolution, or whose stamps are wrong is at fault whatever it says. When everything pauses together
it is the link that was lost.
The results are those of `SensorDecision`, without a statistic, every half second while it lasts.
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
    NEVER_US,
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
from analysis.samples.block import WIDTH, Block

REASONS = {
    SILENT: "silent for {:.2f} s",
    REPEATED: "the same value for {:.2f} s",
    FROZEN_TIME: "its time stands still, {:.2f} s behind",
    JUMPED_AHEAD: "its time leaps {:.2f} s ahead",
    JUMPED_BACK: "its time goes back by {:.2f} s",
    LATE: "{:.2f} s late",
    SPARSE: "comes {:.2f} times as often as usual",
    BURSTING: "{:.0f} samples at once",
}
MOST = 10_000  # results from one block


class StreamDetector(BlockDetector, frozen=True):
    """A step of the pipeline; without a `link` nobody is blamed where everything pauses."""

    channels: ClassVar = frozenset(STREAMS)

    link: bool = True

    def new_state(self) -> StreamStates:
        """Nothing came yet."""
        count = len(STREAMS)
        counts = np.zeros((count, 9), np.int64)
        counts[:, REPORTED_US] = NEVER_US
        return StreamStates(
            counts,
            np.zeros((count, 4)),
            # NaN equals nothing: no first value is a repetition.
            np.full((count, WIDTH), np.nan),
            np.zeros((count, WIDTH, 3), np.int64),
            np.zeros((count, COLUMNS)),
            np.full((2, 6), NEVER_US),
        )

    def step(
        self, block: Block, state: StreamStates
    ) -> tuple[list[tuple[int, SensorDecision]], StreamStates]:
        """What is wrong with the streams of a block, by the row that shows it, and the next state.

        The state is changed in place.
        """
        found = StreamAnomalies(
            np.empty((MOST, 4), np.int64), np.empty(MOST), np.zeros(1, np.int64)
        )
        track_streams(block.kind, block.t_us, block.values, state, found)
        count = int(found.filled[0])
        rows = zip(found.rows[:count].tolist(), found.amounts[:count].tolist(), strict=True)
        return [
            (row, _result(t_us, stream, what, amount))
            for (row, t_us, stream, what), amount in rows
            if self.link or stream != LINK
        ], state


def _result(t_us: int, stream: int, what: int, amount: float) -> SensorDecision:
    return pattern_alarm(
        t_us,
        STREAMS[stream],
        REASONS[what].format(amount),
    )
