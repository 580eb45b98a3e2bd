"""ArduPilot's dataflash logs (.bin) as columns: pymavlink finds the messages, numpy unpacks them.

A message's columns are its fields as the log's own FMT messages name them, scaled as pymavlink
scales them, with `TimeUS` in microseconds since boot. Where an old log gives `TimeMS`, or a message
carries no time at all, `TimeUS` is made from that or from the message before.
"""

import contextlib
import os
import re
import struct
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.misdated_stamps import find_misdated
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.written import written_bytes

Topic = dict[str, NDArray[Any]]
MAGIC = b"\xa3\x95"
HEAD = 3  # bytes of a message before its fields
MAX_BYTES = 500_000_000  # of a file that are read
FORMATS = 0x80  # the type of FMT messages
NUMBERED = ("IMU", "MAG", "GPS", "GPA", "BARO", "BAT", "CURR")  # IMU2 of an old log: a second one
RATES = {"R", "P", "Y", "RDes", "PDes", "YDes"}
INSTANCES = ("I", "C", "Instance")  # what tells the messages of two sensors or cores apart


@dataclass(frozen=True, slots=True)
class DataflashFile:
    """A dataflash log read.

    Attributes
    ----------
    topics : dict
        By message name and instance (from 0) its columns, with `TimeUS`.
    start_us, end_us : int
        First and last time.
    unread_bytes : int
        Bytes at the end of a very large file that were not read.
    damaged : bool
        Whether bytes or messages of an impossible time had to be passed over.
    cut : bool
        Whether it ends in the middle of a message.
    """

    topics: Mapping[tuple[str, int], Topic]
    start_us: int
    end_us: int
    unread_bytes: int
    corrupted: bool
    cut: bool


def is_dataflash(head: bytes) -> bool:
    """Whether a file that begins with these bytes is a dataflash log."""
    return head.startswith(MAGIC)


def read_dataflash(path: str | Path) -> DataflashFile:
    """Read a dataflash log; of one larger than `MAX_BYTES` the beginning.

    Raises
    ------
    ConfigError
        If nothing can be read.
    """
    with _readable_part(Path(path)) as readable, tempfile.TemporaryFile() as complaints:
        try:
            with _redirect_output(complaints):
                raw, cut = _messages(readable)
            damaged = os.fstat(complaints.fileno()).st_size > 0
        except Exception as error:  # pymavlink raises whatever its struct and index code does
            raise ConfigError(f"{path}: not a readable dataflash log ({error})") from error
    times = _clock(raw)
    if len(times[0]) == 0:
        raise ConfigError(f"{path}: the dataflash log holds no message with a time")
    wrong = find_misdated(times[1])
    places, damaged = times[0][wrong], damaged or bool(wrong.any())
    times = times[0][~wrong], times[1][~wrong]
    topics: dict[tuple[str, int], Topic] = {}
    for name, (place, fields) in raw.items():
        sound = ~np.isin(place, places)
        at, columns = place[sound], {key: values[sound] for key, values in fields.items()}
        if not len(at):
            continue
        columns["TimeUS"] = _time_us(name, at, columns, times)
        for key, rows in _instances(name, columns):
            topics[key] = {column: values[rows] for column, values in columns.items()}
    _rates_in_degrees(topics)
    unread_bytes = max(written_bytes(Path(path)) - MAX_BYTES, 0)
    stamps = times[1]
    return DataflashFile(topics, int(stamps.min()), int(stamps.max()), unread_bytes, damaged, cut)


@contextlib.contextmanager
def _redirect_output(file: IO[bytes]) -> Iterator[None]:
    """What is printed, by compiled code too, goes to a file: pymavlink prints what it skips."""
    sys.stdout.flush()
    sys.stderr.flush()
    # At the level of descriptors: compiled code does not print through sys.stdout.
    kept = [(number, os.dup(number)) for number in (1, 2)]
    try:
        for number, _ in kept:
            os.dup2(file.fileno(), number)
        yield
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        for number, copy in kept:
            os.dup2(copy, number)
            os.close(copy)


@contextlib.contextmanager
def _readable_part(path: Path) -> Iterator[Path]:
    """The file, or a copy of as much of it as is read: pymavlink takes whole files only."""
    written = written_bytes(path)
    if written == path.stat().st_size <= MAX_BYTES:
        yield path
        return
    with tempfile.NamedTemporaryFile(suffix=".bin") as copy, path.open("rb") as file:
        remaining = min(written, MAX_BYTES)
        while remaining > 0 and (data := file.read(min(remaining, 1 << 24))):
            copy.write(data)
            remaining -= len(data)
        copy.flush()
        yield Path(copy.name)


def _messages(path: Path) -> tuple[dict[str, tuple[NDArray[np.int64], Topic]], bool]:
    """By message name where its messages are and their columns; whether the last one is cut."""
    from pymavlink.DFReader import DFReader_binary

    reader = DFReader_binary.__new__(DFReader_binary)  # apart, to close its file if it fails
    try:
        reader.__init__(str(path), zero_time_base=True)
        data = np.fromfile(path, np.uint8)
        found = {}
        end = 0
        for form in reader.formats.values():
            at = np.array(reader.offsets[form.type], np.int64)
            # A format may claim less than its fields take, where its bytes are damaged.
            whole = at + max(form.len, HEAD + struct.calcsize(form.msg_struct)) <= len(data)
            at = at[whole]
            end = max(end, int(at.max(initial=0)) + form.len)
            if len(at) and form.type != FORMATS:
                found[form.name] = (at, _columns(data, at, form))
        return found, data[end : end + len(MAGIC)].tobytes() == MAGIC
    finally:
        reader.filehandle.close()


def _columns(data: NDArray[np.uint8], at: NDArray[np.int64], form: Any) -> Topic:
    """The fields of messages of one kind as columns, scaled."""
    codes = re.findall(r"\d*[a-zA-Z]", form.msg_struct)
    types = [f"S{code[:-1]}" if code.endswith("s") else f"<{code}" for code in codes]
    dtype = np.dtype(list(zip(form.columns, types, strict=True)))
    # A view at every byte, of which only those at messages are read: nothing is copied.
    windows = np.lib.stride_tricks.sliding_window_view(data, dtype.itemsize)
    rows = windows[at + HEAD].view(dtype)[:, 0]
    return {
        name: rows[name] if factor is None else rows[name] * factor
        for name, factor in zip(form.columns, form.msg_mults, strict=True)
    }


def _own_time(name: str, columns: Topic) -> NDArray[np.int64] | None:
    """The time since boot that messages carry, microseconds; None if they carry none."""
    if "TimeUS" in columns:
        return columns["TimeUS"].astype(np.int64)
    # Of old logs: a GPS message's TimeMS is the time of the week.
    key = "T" if name.startswith("GPS") else "TimeMS"
    return columns[key].astype(np.int64) * 1000 if key in columns else None


def _clock(
    raw: Mapping[str, tuple[NDArray[np.int64], Topic]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places in the file and the times given there, in order."""
    places, times = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for name, (at, columns) in raw.items():
        own = _own_time(name, columns)
        if own is not None:
            places.append(at)
            times.append(own)
    place = np.concatenate(places)
    order = np.argsort(place)
    return place[order], np.concatenate(times)[order]


def _time_us(
    name: str,
    at: NDArray[np.int64],
    columns: Topic,
    times: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> NDArray[np.int64]:
    """The time of each message, its own or that of the nearest before it."""
    own = _own_time(name, columns)
    if own is not None:
        return own
    return times[1][np.maximum(np.searchsorted(times[0], at) - 1, 0)]


def _rates_in_degrees(topics: Mapping[tuple[str, int], Topic]) -> None:
    """Make RATE degrees per second, which logs of 2015 and before give in hundredths."""
    rate, imu = topics.get(("RATE", 0), {}), topics.get(("IMU", 0), {})
    if "R" not in rate or "GyrX" not in imu:
        return
    turned = np.degrees(np.interp(rate["TimeUS"], imu["TimeUS"], imu["GyrX"]))
    # Ten lies between one and a hundred: filters and delays change less.
    if np.median(np.abs(rate["R"])) > 10.0 * np.median(np.abs(turned)) > 0.0:
        for name in rate.keys() & RATES:
            rate[name] = rate[name] * 0.01


def _instances(
    name: str, columns: Topic
) -> Iterator[tuple[tuple[str, int], NDArray[np.bool_] | slice]]:
    """Name and instance of the messages of one kind, and which rows they are."""
    key = next((key for key in INSTANCES if key in columns), None)
    if key is not None and columns[key].dtype.kind in "iu":
        for instance in np.unique(columns[key]).tolist():
            yield (name, instance), columns[key] == instance
    elif name[-1:].isdigit() and name[:-1] in NUMBERED:
        yield (name[:-1], int(name[-1]) - 1), slice(None)
    else:
        yield (name, 0), slice(None)
