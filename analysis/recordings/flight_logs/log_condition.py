"""What a log has lost: parts that are damaged, and records that its writer had no time for."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

CORRUPTED = "parts of the file are damaged and were passed over"
MAX_JUNK_SHARE = (
    1e-3  # share of a tlog's bytes that are no frame, beyond which it counts as damaged
)

Stretch = tuple[int, int]


@dataclass
class LogCondition:
    """Filled by whoever reads a log.

    Attributes
    ----------
    damage : list of str
        What is broken or missing in the file.
    lost_us : list of (from_us, to_us)
        When its writer says that it lost records; what did not come then may have been there.
    """

    damage: list[str] = field(default_factory=list)
    lost_us: list[Stretch] = field(default_factory=list)

    def note_junk(self, junk_bytes: int, size: int) -> None:
        """Of a tlog: bytes of it that are no frame. The last frame of any may be cut."""
        if junk_bytes > MAX_JUNK_SHARE * size:
            share = 100.0 * junk_bytes / size
            self.damage.append(f"{junk_bytes} of {size} bytes ({share:.2g} %) are no frame")


def dataflash_losses(topics: Mapping[tuple[str, int], Mapping[str, NDArray[Any]]]) -> list[Stretch]:
    """When ArduPilot's logger dropped records, by its own count (DSF.Dp)."""
    told = topics.get(("DSF", 0), {})
    if not {"TimeUS", "Dp"} <= told.keys():
        return []
    stamps, dropped = told["TimeUS"].astype(np.int64), told["Dp"].astype(np.int64)
    grown = np.flatnonzero(np.diff(dropped) > 0)
    return [(int(stamps[i]), int(stamps[i + 1])) for i in grown]


def ulog_losses(dropouts: list[tuple[int, float]]) -> list[Stretch]:
    """When PX4's logger wrote nothing; each is stamped with the newest stamp before it."""
    return [(t_us, t_us + round(duration_s * 1e6)) for t_us, duration_s in dropouts]
