"""Read PX4 ULog files as columns, with pyulog.

A topic's columns are its fields as pyulog names them (`q[0]`), with `timestamp` in microseconds on
the vehicle's clock. Fields that PX4 1.14 renamed have their new names.
"""

import contextlib
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.misdated_stamps import find_misdated
from analysis.recordings.flight_logs.ulog_texts import logged_texts, printed_texts
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.written import written_bytes

NUMBER = (int, float)  # valid types of a parameter; a corrupted definition gives others
Topic = dict[str, NDArray[Any]]
MAGIC = b"ULog\x01\x12\x35"
PROGRESS_STEP_BYTES = 1 << 20  # between two progress reports
MAX_READ_FACTOR = 100  # limit on bytes read, in file sizes, against endless reading
STALE_US = 1_000_000  # chosen: sensors are sampled more often
DEGREES = {"lat": "latitude_deg", "lon": "longitude_deg"}


@dataclass(frozen=True, slots=True)
class ULogFile:
    """Contents of a ULog.

    Attributes
    ----------
    topics : dict
        Columns by topic name and instance.
    messages : list of (t_us, severity, text)
        Texts of the autopilot; severity as in MAVLink, 0 (worst) to 7.
    parameters : dict
        Initial parameters by name.
    changes : list of (t_us, name, value)
        Parameters changed in flight.
    defaults : dict
        Default values by name, if the log has them.
    info : dict
        The file's information messages (version, hardware).
    dropouts : list of (t_us, duration_s)
    printed : dict
        Console output, processes and performance counters by title.
    corrupted : bool
        Whether parts of the file could not be read.
    cut : bool
        Whether the file ends within a message.
    stale : int
        First samples of topics from before the log, which count as of its beginning.
    """

    topics: Mapping[tuple[str, int], Topic]
    messages: list[tuple[int, int, str]]
    parameters: dict[str, float]
    changes: list[tuple[int, str, float]]
    defaults: dict[str, float]
    info: dict[str, Any]
    start_us: int
    dropouts: list[tuple[int, float]]
    printed: dict[str, str]
    corrupted: bool
    cut: bool
    stale: int


class _BoundedFile(io.FileIO):
    """A file that stops pyulog from reading the same corrupted bytes endlessly.

    It ends where the written part of the file ends, and reports the reading progress.
    """

    def __init__(self, path: str | Path, progress: Callable[[float], None]) -> None:
        super().__init__(path, "rb")
        self.cut = False  # whether a read reached the end too early
        self._written = written_bytes(Path(path))
        self._remaining_reads = MAX_READ_FACTOR * self._written + 10_000_000
        self._progress, self._report_at = progress, 0

    def read(self, size: int | None = -1, /) -> bytes:
        """Read as from any file; RuntimeError once too much has been read."""
        at = self.tell()
        left = max(self._written - at, 0)
        data = super().read(left if size is None or size < 0 else min(size, left)) or b""
        self.cut |= size is not None and 0 < len(data) < size
        self._remaining_reads -= len(data) + 1
        if self._remaining_reads < 0:
            raise RuntimeError("corrupted beyond reading")
        if at >= self._report_at:
            self._report_at = at + PROGRESS_STEP_BYTES
            self._progress(at / self._written)
        return data


def is_ulog(head: bytes) -> bool:
    """Whether a file that begins with these bytes is a ULog."""
    return head.startswith(MAGIC)


def read_ulog(path: str | Path, progress: Callable[[float], None] = lambda _: None) -> ULogFile:
    """Read a ULog; of a corrupted file the readable part, with `corrupted` set.

    `progress` is called with the share that is read, from 0 to 1.

    Raises
    ------
    ConfigError
        If nothing can be read.
    """
    from pyulog import ULog

    complaints = io.StringIO()  # pyulog prints what it cannot read
    try:
        file = _BoundedFile(path, progress)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give the path of a ULog") from error
    try:
        with file, contextlib.redirect_stdout(complaints):
            log = ULog(file)
    except Exception as error:  # pyulog raises any type of error on corrupted input
        raise ConfigError(f"{path}: not a readable ULog ({error}); give a complete file") from error
    topics = {
        (data.name, data.multi_id): _with_newer_names(data.data)
        for data in log.data_list
        if len(data.data.get("timestamp", ()))  # some topics are declared and never logged
    }
    stale = _clip_stale(topics, int(log.start_timestamp))
    wrong = remove_misdated(topics)
    return ULogFile(
        topics,
        logged_texts(log),
        {name: float(v) for name, v in log.initial_parameters.items() if isinstance(v, NUMBER)},
        [
            (t_us, name, float(v))
            for t_us, name, v in log.changed_parameters
            if isinstance(v, NUMBER)
        ],
        _defaults(log),
        dict(log.msg_info_dict),
        int(log.start_timestamp),
        [(drop.timestamp, drop.duration * 1e-3) for drop in log.dropouts],
        printed_texts(log),
        bool(log.file_corruption or complaints.getvalue() or wrong),
        file.cut,
        stale,
    )


def _clip_stale(topics: Mapping[tuple[str, int], Topic], start_us: int) -> int:
    """Move samples published before the log began to its beginning; returns how many they are.

    The logger writes the newest sample of every topic first, which may be minutes old.
    """
    count = 0
    for topic in topics.values():
        old = topic["timestamp"] < start_us - STALE_US
        if old.any():
            count += int(old.sum())
            topic["timestamp"] = np.where(old, np.uint64(start_us), topic["timestamp"])
    return count


def remove_misdated(topics: dict[tuple[str, int], Topic]) -> bool:
    """Remove rows with a wrong timestamp; returns whether there were any."""
    found = False
    for topic in topics.values():
        wrong = find_misdated(topic["timestamp"].astype(np.int64))
        if wrong.any():
            found = True
            topic.update({name: values[~wrong] for name, values in topic.items()})
    return found


def _defaults(log: Any) -> dict[str, float]:
    """Default of every parameter; the log lists only defaults that differ from the value in use."""
    if not log.has_default_parameters:
        return {}
    # The defaults of the firmware and the airframe override the values in use.
    every = log.initial_parameters | log.get_default_parameters(0) | log.get_default_parameters(1)
    return {name: float(value) for name, value in every.items() if isinstance(value, NUMBER)}


def _with_newer_names(columns: Mapping[str, NDArray[Any]]) -> Topic:
    """Add the new names of position fields; older PX4 logs 1e-7 degrees and millimetres."""
    found = dict(columns)
    for old, new in DEGREES.items():
        if old in found and new not in found:
            raw = found[old]
            scale = 1e-7 if np.issubdtype(raw.dtype, np.integer) else 1.0
            # Integers are 1e-7 degrees; some versions have degrees under the old name.
            found[new] = raw * scale
    if "alt" in found and "altitude_msl_m" not in found:
        raw = found["alt"]
        scale = 1e-3 if np.issubdtype(raw.dtype, np.integer) else 1.0
        found["altitude_msl_m"] = raw * scale
    return found
