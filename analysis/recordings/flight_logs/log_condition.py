"""Condition of a log: corrupted parts, and records that the logger dropped."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from analysis.recordings.flight_logs.logged_rows import Topic

MAX_JUNK_SHARE = 1e-3  # share of a tlog's bytes outside frames, above which it counts as corrupted


@dataclass
class LogCondition:
    """Collected by the readers of a log."""

    damage: list[str] = field(default_factory=list)  # one text per kind of damage
    # Periods in which the logger reports dropped records; the sensors may have been sampled.
    lost_us: list[tuple[int, int]] = field(default_factory=list)

    def note_junk(self, junk_bytes: int, size: int) -> None:
        """Note the bytes of a tlog outside frames; an incomplete last frame is not corruption."""
        if junk_bytes > MAX_JUNK_SHARE * size:
            share = 100.0 * junk_bytes / size
            self.damage.append(f"{junk_bytes} of {size} bytes ({share:.2g} %) are not frames")


def dataflash_losses(topics: Mapping[tuple[str, int], Topic]) -> list[tuple[int, int]]:
    """Periods in which ArduPilot's logger dropped records, from its own counter (DSF.Dp)."""
    counter = topics.get(("DSF", 0), {})
    if not {"TimeUS", "Dp"} <= counter.keys():
        return []
    stamps, dropped = counter["TimeUS"].astype(np.int64), counter["Dp"].astype(np.int64)
    grown = np.flatnonzero(np.diff(dropped) > 0)
    return [(int(stamps[i]), int(stamps[i + 1])) for i in grown]
