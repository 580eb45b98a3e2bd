"""Read PX4 ULog files as columns.

A topic's columns are its fields, elements of arrays each (`q[0]`), with `timestamp` in microseconds
(`log_time`). Fields that PX4 1.14 renamed have their new names.
"""

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.autopilot_log import AutopilotLog, LoggedTexts
from analysis.recordings.flight_logs.log_time import RowStamps, RowTimes, place_rows
from analysis.recordings.flight_logs.logged_rows import BlockRows, Rows, Thin, Topic, join_rows
from analysis.recordings.flight_logs.ulog_messages import (
    MAGIC,
    NUMBERS,
    ULogMessages,
    walk_messages,
)
from analysis.recordings.flight_logs.ulog_texts import logged_texts, printed_texts
from mavproxy_fault.documents.errors import ConfigError, users_path
from mavproxy_fault.wire.written import written_bytes

NEWER_NAMES = {
    "lat": ("latitude_deg", 1e-7), "lon": ("longitude_deg", 1e-7), "alt": ("altitude_msl_m", 1e-3),
}  # fmt: skip
KEY = re.compile(r"(\w+)(?:\[(\d+)\])? (.+)", re.ASCII)
OTHER_CLOCKS = ("timestamp_sample", "time_utc_usec")
PLACED = {"L": 1, "C": 3}  # kinds of messages with a stamp, and where it stands


def is_ulog(head: bytes) -> bool:
    """Whether a file that begins with these bytes is a ULog."""
    return head.startswith(MAGIC)


class ULogRows:
    """The rows of a ULog's topics."""

    def __init__(self, path: Path, progress: Callable[[float], None]) -> None:
        self.messages = ULogMessages()  # of the newest walk
        self._path, self._progress = path, progress

    def blocks(self) -> Iterator[BlockRows]:
        """The rows of each block."""
        self.messages, size = ULogMessages(), written_bytes(self._path)
        return walk_messages(self._path, size, self.messages, self._progress)

    def stamps(self, _: tuple[str, int], rows: Rows) -> RowStamps:
        """Places and stamps of rows."""
        names = rows.dtype.names or ()
        other = next((name for name in OTHER_CLOCKS if name in names), None)
        own = rows["timestamp"].astype(np.int64) if "timestamp" in names else None
        return RowStamps(rows["at"], own, None if other is None else rows[other].astype(np.int64))

    def topics(
        self, key: tuple[str, int], rows: Rows, t_us: NDArray[np.int64]
    ) -> Iterator[tuple[tuple[str, int], Topic]]:
        """The columns of rows."""
        columns = {name: rows[name] for name in rows.dtype.names or () if name != "at"}
        yield key, _with_newer_names(columns | {"timestamp": t_us})


def read_ulog(
    path: str | Path,
    progress: Callable[[float], None] = lambda _: None,
    thin: Thin | None = None,
) -> AutopilotLog:
    """Read a ULog; of a corrupted file the readable part, with `corrupted` set.

    `progress` is called with the share that is read, from 0 to 1.

    Raises
    ------
    ConfigError
        If nothing can be read.
    """
    logged = ULogRows(Path(path), progress)
    with users_path(path, "give the path of a ULog"):
        raw = join_rows(logged.blocks(), thin)
    found = logged.messages
    if not found.formats:
        raise ConfigError(f"{path}: not a readable ULog; give a complete file")
    others = {kind: [row for row in found.others if row[1] == kind] for kind in "LCPOQIM"}
    placed: dict[Any, RowStamps] = {kind: _placed(kind, rows) for kind, rows in others.items()}
    stamps = {key: logged.stamps(key, rows) for key, rows in raw.items()}
    times = place_rows(placed | stamps, begin_us=found.begin_us)
    if not any(times.times[key].any() for key in raw):
        raise ConfigError(f"{path}: holds no message with a time; give a log of a flight")
    begin = min(int(rows["at"][0]) for rows in raw.values())
    topics: dict[tuple[str, int], Topic] = {}
    for key, keep in times.keep.items():
        # Each topic's rows are given up for its columns, to limit memory.
        if key in raw and keep.any():
            topics.update(logged.topics(key, raw.pop(key)[keep], times.times[key][keep]))
    texts = _texts(others, times)
    info = dict(_keyed(payload) for _, _, payload in others["I"])
    several = _several_infos(others["M"])
    parameters, changes = _parameters(begin, others["P"], times)
    dropouts = [
        (int(t_us), int.from_bytes(payload[:2], "little") * 1e-3)
        for t_us, (_, _, payload) in zip(times.times["O"], others["O"], strict=True)
    ]
    end_us = max(int(topic["timestamp"][-1]) for topic in topics.values())
    return AutopilotLog(
        "px4", logged, thin is not None, topics, times.begin_us, end_us, times,
        found.skipped_bytes > 0 or times.misdated, found.cut,
        logged_texts(texts, topics.get(("event", 0), {}), info, several), parameters,
        _defaults(others["Q"], parameters), changes, info, dropouts, printed_texts(several),
    )  # fmt: skip


def _placed(kind: str, rows: list[tuple[int, str, bytes]]) -> RowStamps:
    """Places and stamps of other messages."""
    at = np.array([row[0] for row in rows], np.int64)
    if kind not in PLACED:
        return RowStamps(at, None)
    stamps = [struct.unpack_from("<Q", row[2], PLACED[kind])[0] for row in rows]
    return RowStamps(at, np.array(stamps, np.uint64).astype(np.int64))


def _texts(others: Mapping[str, list[tuple[int, str, bytes]]], times: RowTimes) -> LoggedTexts:
    """Logged messages; the level is an ASCII digit, `& 7` makes a corrupted one valid."""
    return [
        (int(t_us), (payload[0] - ord("0")) & 7, _decoded(payload[PLACED[kind] + 8 :]).strip())
        for kind in PLACED
        for t_us, (_, _, payload) in zip(times.times[kind], others[kind], strict=True)
    ]


def _decoded(text: bytes) -> str:
    return text.split(b"\0", 1)[0].decode("utf-8", "replace")


def _keyed(payload: bytes) -> tuple[str, Any]:
    """Key and value of an information message; a value of another type as bytes."""
    length = payload[0]
    key = KEY.match(payload[1 : 1 + length].decode("latin-1"))
    value = payload[1 + length :]
    if key is None:
        return "", value
    if key[1] == "char":
        return key[3], _decoded(value)
    kind = np.dtype(NUMBERS.get(key[1], "V1"))
    if not key[2] and len(value) == kind.itemsize:
        return key[3], np.frombuffer(value, kind)[0].item()
    return key[3], value


def _several_infos(rows: list[tuple[int, str, bytes]]) -> dict[str, list[list[Any]]]:
    """Information in several parts: the continued parts of each message."""
    found: dict[str, list[list[Any]]] = {}
    for _, _, payload in rows:
        key, value = _keyed(payload[1:])
        parts = found.setdefault(key, [])
        if payload[0] and parts:
            parts[-1].append(value)
        else:
            parts.append([value])
    return found


def _parameters(
    begin: int, rows: list[tuple[int, str, bytes]], times: RowTimes
) -> tuple[dict[str, float], list[tuple[int, str, float]]]:
    """Parameters before the first sample at `begin`, and those that change after it."""
    initial, changes = {}, []
    for t_us, (at, _, payload) in zip(times.times["P"].tolist(), rows, strict=True):
        name, value = _keyed(payload)
        # A corrupted definition gives another type, or no number.
        if isinstance(value, (int, float)) and np.isfinite(value):
            if at < begin:
                initial[name] = float(value)
            else:
                changes.append((t_us, name, float(value)))
    return initial, changes


def _defaults(
    rows: list[tuple[int, str, bytes]], parameters: Mapping[str, float]
) -> dict[str, float]:
    """Default of every parameter; the log lists only defaults that differ from the value in use."""
    if not rows:
        return {}
    # The defaults of the firmware (bit 0) and the airframe (bit 1) override the values in use.
    found = dict(parameters)
    for bit in (1, 2):
        found |= {
            name: float(value)
            for _, _, payload in rows
            if payload[0] & bit
            for name, value in [_keyed(payload[1:])]
            if isinstance(value, (int, float))
        }
    return found


def _with_newer_names(columns: Mapping[str, NDArray[Any]]) -> Topic:
    """Add the new names of position fields; older PX4 logs 1e-7 degrees and millimetres."""
    # Some versions have degrees and metres under the old name.
    newer = {
        new: columns[old] * (scale if columns[old].dtype.kind in "iu" else 1.0)
        for old, (new, scale) in NEWER_NAMES.items()
        if old in columns and new not in columns
    }
    return {**columns, **newer}
