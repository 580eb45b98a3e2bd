"""The contents of an autopilot's own log, a ULog or a dataflash log."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from analysis.recordings.flight_logs.log_time import RowTimes
from analysis.recordings.flight_logs.logged_rows import Topic

LoggedTexts = list[tuple[int, int, str]]  # t_us, severity as in MAVLink, text
CORRUPTED = "parts of the file are corrupted and were skipped"


@dataclass(frozen=True, slots=True)
class AutopilotLog:
    """Contents of a ULog or a dataflash log; what follows `cut` only a ULog has beside topics."""

    autopilot: str  # "px4" or "ardupilot"
    rows: Any  # as logged, block by block: `DataflashRows` or `ULogRows`
    thinned: bool  # whether the topics lack rows
    # Columns by message name and instance (from 0), with the time in us as `stamp`.
    topics: Mapping[tuple[str, int], Topic]
    start_us: int  # first and last time
    end_us: int
    times: RowTimes  # what was found out about the stamps
    corrupted: bool  # whether bytes or messages with an impossible time were skipped
    cut: bool  # whether the file ends within a message
    messages: LoggedTexts = field(default_factory=list)
    parameters: dict[str, float] = field(default_factory=dict)  # initial ones by name
    defaults: dict[str, float] = field(default_factory=dict)
    # Time in us, name and value of parameters changed in flight.
    changes: list[tuple[int, str, float]] = field(default_factory=list)
    info: dict[str, Any] = field(default_factory=dict)  # version, hardware
    dropouts: list[tuple[int, float]] = field(default_factory=list)  # time in us, duration in s
    # Console output, processes and performance counters by title.
    printed: dict[str, str] = field(default_factory=dict)

    @property
    def stamp(self) -> str:
        """Name of the column with the time."""
        return "timestamp" if self.autopilot == "px4" else "TimeUS"

    def notes(self) -> list[str]:
        """Notes for readers of a report on what was found out about the log."""
        found = self.times.notes()
        if self.dropouts:
            total_s = sum(duration_s for _, duration_s in self.dropouts)
            found.append(f"{len(self.dropouts)} dropouts in the log, {total_s:.2f} s in all")
        if self.cut:
            found.append("the file ends within a message: the log is truncated")
        return found + ([CORRUPTED] if self.corrupted else [])
