"""PX4's ULog files as columns, by pyulog.

A topic's columns are its fields as pyulog names them (`q[0]`), with `timestamp` in microseconds on
the vehicle's clock. Field names that PX4 1.14 and later changed are given their newer form.
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

NUMBER = (int, float)  # what a parameter is, unless its definition is damaged
Topic = dict[str, NDArray[Any]]
MAGIC = b"ULog\x01\x12\x35"
PROGRESS_STEP_BYTES = 1 << 20  # between two words of how far the reader is
MAX_READ_FACTOR = 100  # times the file's size that a reader may read of it
DEGREES = {"lat": "latitude_deg", "lon": "longitude_deg"}


@dataclass(frozen=True, slots=True)
class ULogFile:
    """A ULog read.

    Attributes
    ----------
    topics : dict
        By topic name and instance its columns.
    messages : list of (t_us, severity, text)
        What the autopilot said, severity as in MAVLink, 0 (worst) to 7.
    parameters : dict
        Initial parameters by name.
    changes : list of (t_us, name, value)
        Parameters changed in flight.
    defaults : dict
        Default values by name, where the log tells them.
    info : dict
        The file's information messages (version, hardware).
    dropouts : list of (t_us, duration_s)
    printed : dict
        By title what the system printed: console, processes, counters.
    damaged : bool
        Whether parts of the file could not be read.
    cut : bool
        Whether it ends in the middle of a message.
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


class _BoundedFile(io.FileIO):
    """A file that ends a reader which goes over the same damaged bytes for ever, as pyulog can.

    It ends where nothing was written any more, and tells how far the reader is.
    """

    def __init__(self, path: str | Path, told: Callable[[float], None]) -> None:
        super().__init__(path, "rb")
        self.cut = False  # whether it ended in the middle of what a reader asked for
        self._written = written_bytes(Path(path))
        self._remaining_reads = MAX_READ_FACTOR * self._written + 10_000_000
        self._told, self._tell_at = told, 0

    def read(self, size: int | None = -1, /) -> bytes:
        """As in any file, until too much was read."""
        at = self.tell()
        left = max(self._written - at, 0)
        data = super().read(left if size is None or size < 0 else min(size, left)) or b""
        self.cut |= size is not None and 0 < len(data) < size
        self._remaining_reads -= len(data) + 1
        if self._remaining_reads < 0:
            raise RuntimeError("damaged beyond reading")
        if at >= self._tell_at:
            self._tell_at = at + PROGRESS_STEP_BYTES
            self._told(at / self._written)
        return data


def is_ulog(head: bytes) -> bool:
    """Whether a file that begins with these bytes is a ULog."""
    return head.startswith(MAGIC)


def read_ulog(path: str | Path, told: Callable[[float], None] = lambda _: None) -> ULogFile:
    """Read a whole ULog; what a damaged file still holds comes back with `corrupted` set.

    `told` is called with the share that is read, from 0 to 1.

    Raises
    ------
    ConfigError
        If nothing can be read.
    """
    from pyulog import ULog

    complaints = io.StringIO()  # pyulog prints what it cannot read
    try:
        file = _BoundedFile(path, told)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give the path of a ULog") from error
    try:
        with file, contextlib.redirect_stdout(complaints):
            log = ULog(file)
    except Exception as error:  # pyulog raises whatever its struct and index code does
        raise ConfigError(f"{path}: not a readable ULog ({error}); give a whole file") from error
    topics = {
        (data.name, data.multi_id): _with_newer_names(data.data)
        for data in log.data_list
        if len(data.data.get("timestamp", ()))  # some are announced and never logged
    }
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
    )


def remove_misdated(topics: dict[tuple[str, int], Topic]) -> bool:
    """Take out rows whose stamp lies far from those around it; whether there were any."""
    found = False
    for topic in topics.values():
        wrong = find_misdated(topic["timestamp"].astype(np.int64))
        if wrong.any():
            found = True
            topic.update({name: values[~wrong] for name, values in topic.items()})
    return found


def _defaults(log: Any) -> dict[str, float]:
    """What every parameter would be untouched: the log names only defaults that differ from it."""
    if not log.has_default_parameters:
        return {}
    # In this order, so that the firmware's and the airframe's defaults win.
    every = log.initial_parameters | log.get_default_parameters(0) | log.get_default_parameters(1)
    return {name: float(value) for name, value in every.items() if isinstance(value, NUMBER)}


def _with_newer_names(columns: Mapping[str, NDArray[Any]]) -> Topic:
    """Older PX4 gave positions in 1e-7 degrees and millimetres."""
    found = dict(columns)
    for old, new in DEGREES.items():
        if old in found and new not in found:
            raw = found[old]
            scale = 1e-7 if np.issubdtype(raw.dtype, np.integer) else 1.0
            # Integers are 1e-7 degrees; some versions had degrees under the old name.
            found[new] = raw * scale
    if "alt" in found and "altitude_msl_m" not in found:
        raw = found["alt"]
        scale = 1e-3 if np.issubdtype(raw.dtype, np.integer) else 1.0
        found["altitude_msl_m"] = raw * scale
    return found
