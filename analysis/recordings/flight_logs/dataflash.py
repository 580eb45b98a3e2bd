"""Read ArduPilot dataflash logs (.bin) as columns; pymavlink finds messages, numpy unpacks them.

A message's columns are its fields as the log's own FMT messages name them, scaled as pymavlink
scales them, with `TimeUS` in microseconds since boot. In old logs it is computed from `TimeMS`; a
message without a time gets that of the message before it.
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
HEAD = 3  # header bytes of a message
MAX_BYTES = 500_000_000  # read of a file, to limit memory use
FORMATS = 0x80  # the type of FMT messages
NUMBERED = ("IMU", "MAG", "GPS", "GPA", "BARO", "BAT", "CURR")  # old logs: IMU2 is instance 1
RATES = {"R", "P", "Y", "RDes", "PDes", "YDes"}
INSTANCES = ("I", "C", "Instance")  # fields with the number of the sensor or core


@dataclass(frozen=True, slots=True)
class DataflashFile:
    """Contents of a dataflash log.

    Attributes
    ----------
    topics : dict
        Columns, with `TimeUS`, by message name and instance (from 0).
    start_us, end_us : int
        First and last time.
    unread_bytes : int
        Bytes at the end of a very large file that were not read.
    corrupted : bool
        Whether bytes or messages with an impossible time were skipped.
    cut : bool
        Whether the file ends within a message.
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
    """Read a dataflash log; of a file larger than `MAX_BYTES` only the beginning.

    Raises
    ------
    ConfigError
        If the file is not a dataflash log or holds no message with a time.
    """
    with _readable_part(Path(path)) as readable, tempfile.TemporaryFile() as complaints:
        try:
            with _redirect_output(complaints):
                raw, cut = _messages(readable)
            corrupted = os.fstat(complaints.fileno()).st_size > 0
        except Exception as error:  # pymavlink raises any type of error on corrupted input
            raise ConfigError(f"{path}: not a dataflash log ({error}); give a .bin file") from error
    times = _clock(raw)
    if len(times[0]) == 0:
        raise ConfigError(f"{path}: holds no message with a time; give a dataflash log of a flight")
    wrong = find_misdated(times[1])
    places, corrupted = times[0][wrong], corrupted or bool(wrong.any())
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
    return DataflashFile(topics, int(stamps.min()), int(stamps.max()), unread_bytes, corrupted, cut)


@contextlib.contextmanager
def _redirect_output(file: IO[bytes]) -> Iterator[None]:
    """Redirect stdout and stderr to a file, to detect what pymavlink skips: it only prints it."""
    sys.stdout.flush()
    sys.stderr.flush()
    # Redirect file descriptors: compiled code does not print through sys.stdout.
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
    """The file, or a copy of its first `MAX_BYTES`: pymavlink always reads complete files."""
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
    """File offsets and columns by message name; and whether the last message is incomplete."""
    from pymavlink.DFReader import DFReader_binary

    reader = DFReader_binary.__new__(DFReader_binary)  # so that its file is closed on failure
    try:
        reader.__init__(str(path), zero_time_base=True)
        data = np.fromfile(path, np.uint8)
        found = {}
        end = 0
        for form in reader.formats.values():
            at = np.array(reader.offsets[form.type], np.int64)
            # A corrupted FMT message may declare a length too short for its fields.
            complete = at + max(form.len, HEAD + struct.calcsize(form.msg_struct)) <= len(data)
            at = at[complete]
            end = max(end, int(at.max(initial=0)) + form.len)
            if len(at) and form.type != FORMATS:
                found[form.name] = (at, _columns(data, at, form))
        return found, data[end : end + len(MAGIC)].tobytes() == MAGIC
    finally:
        reader.filehandle.close()


def _columns(data: NDArray[np.uint8], at: NDArray[np.int64], form: Any) -> Topic:
    """The fields of all messages of one type as scaled columns."""
    codes = re.findall(r"\d*[a-zA-Z]", form.msg_struct)
    types = [f"S{code[:-1]}" if code.endswith("s") else f"<{code}" for code in codes]
    dtype = np.dtype(list(zip(form.columns, types, strict=True)))
    # A sliding view over all bytes, indexed at the messages only: nothing is copied.
    windows = np.lib.stride_tricks.sliding_window_view(data, dtype.itemsize)
    rows = windows[at + HEAD].view(dtype)[:, 0]
    return {
        name: rows[name] if factor is None else rows[name] * factor
        for name, factor in zip(form.columns, form.msg_mults, strict=True)
    }


def _own_time(name: str, columns: Topic) -> NDArray[np.int64] | None:
    """The time since boot in the messages, in microseconds; None if they have none."""
    if "TimeUS" in columns:
        return columns["TimeUS"].astype(np.int64)
    # Old logs: TimeMS of a GPS message is the time of week, T the time since boot.
    key = "T" if name.startswith("GPS") else "TimeMS"
    return columns[key].astype(np.int64) * 1000 if key in columns else None


def _clock(
    raw: Mapping[str, tuple[NDArray[np.int64], Topic]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """File offsets and times of all messages with a time, in file order."""
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
    """The time of each message: its own, or that of the last message before it."""
    own = _own_time(name, columns)
    if own is not None:
        return own
    return times[1][np.maximum(np.searchsorted(times[0], at) - 1, 0)]


def _rates_in_degrees(topics: Mapping[tuple[str, int], Topic]) -> None:
    """Convert RATE to degrees per second; logs up to 2015 give hundredths."""
    rate, imu = topics.get(("RATE", 0), {}), topics.get(("IMU", 0), {})
    if "R" not in rate or "GyrX" not in imu:
        return
    turned = np.degrees(np.interp(rate["TimeUS"], imu["TimeUS"], imu["GyrX"]))
    # The ratio to the gyroscope is 1 or 100; filters and delays change it by far less than 10.
    if np.median(np.abs(rate["R"])) > 10.0 * np.median(np.abs(turned)) > 0.0:
        for name in rate.keys() & RATES:
            rate[name] = rate[name] * 0.01


def _instances(
    name: str, columns: Topic
) -> Iterator[tuple[tuple[str, int], NDArray[np.bool_] | slice]]:
    """Name, instance and rows of each instance of a message type."""
    key = next((key for key in INSTANCES if key in columns), None)
    if key is not None and columns[key].dtype.kind in "iu":
        for instance in np.unique(columns[key]).tolist():
            yield (name, instance), columns[key] == instance
    elif name[-1:].isdigit() and name[:-1] in NUMBERED:
        yield (name[:-1], int(name[-1]) - 1), slice(None)
    else:
        yield (name, 0), slice(None)
