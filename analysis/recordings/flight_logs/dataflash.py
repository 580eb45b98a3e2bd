"""Read ArduPilot dataflash logs (.bin) as columns.

A message's columns are its fields as the log's own FMT messages name them, scaled as pymavlink
scales them, with `TimeUS` in microseconds (`log_time`), in old logs from `TimeMS`.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.autopilot_log import AutopilotLog, Topic
from analysis.recordings.flight_logs.dataflash_blocks import (
    BlockWalk,
    read_formats,
    rows_by_type,
    walk_blocks,
)
from analysis.recordings.flight_logs.dataflash_formats import FIRST, MAGIC, TYPES, MessageFormat
from analysis.recordings.flight_logs.log_time import RowStamps, place_rows
from analysis.recordings.flight_logs.misdated_stamps import find_misdated
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.written import written_bytes

Rows = NDArray[np.void]
HEAD = 4096  # bytes of a file that show its kind: text may stand in front of a log
NUMBERED = ("IMU", "MAG", "GPS", "GPA", "BARO", "BAT", "CURR")  # old logs: IMU2 is instance 1
RATES = {"R", "P", "Y", "RDes", "PDes", "YDes"}
# Fields with the number of the sensor or core.
INSTANCES = ("I", "C", "Instance", "Inst", "IMU")
MOST_INSTANCES = 32  # of motors; a larger number is a wrong byte


def is_dataflash(head: bytes) -> bool:
    """Whether a file that begins with these bytes (`HEAD` of them) is a dataflash log."""
    return head.startswith(MAGIC) or FIRST in head


def read_dataflash(
    path: str | Path,
    only: Collection[str] | None = None,
    thin: Callable[[Rows], Rows] = lambda rows: rows,
) -> AutopilotLog:
    """Read a dataflash log, block by block: all messages, or `only` those with these names (without
    numbers of instances).

    `thin` chooses the rows (k,) to keep of those (n,) of one message in a block.

    Raises
    ------
    ConfigError
        If the file is not a dataflash log or holds no message with a time.
    """
    path = Path(path)
    try:
        size = written_bytes(path)
        walk = BlockWalk(forms=read_formats(path, size))
        raw = _read_messages(path, size, walk, only, thin)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give the path of a .bin file") from error
    columns = {name: _columns(rows, form) for name, (rows, form) in raw.items()}
    times = place_rows(
        {name: RowStamps(rows["at"], *_own_times(name, columns[name]))
         for name, (rows, _) in raw.items()},
        walk.boots[1:],
    )  # fmt: skip
    if not any(some.any() for some in times.times.values()):
        raise ConfigError(f"{path}: holds no message with a time; give a dataflash log of a flight")
    corrupted = walk.skipped_bytes > 0 or times.misdated
    topics: dict[tuple[str, int], Topic] = {}
    for name, keep in times.keep.items():
        every = columns[name] | {"TimeUS": times.times[name]}
        every = {column: values[keep] for column, values in every.items()}
        for key, some in _instances(name, every) if keep.any() else ():
            topic = {column: values[some] for column, values in every.items()}
            topics[key], some_wrong = _in_order(topic)
            corrupted = corrupted or some_wrong
    _rates_in_degrees(topics)
    ends = [(topic["TimeUS"][0], topic["TimeUS"][-1]) for topic in topics.values()]
    start_us, end_us = min(first for first, _ in ends), max(last for _, last in ends)
    return AutopilotLog("ardupilot", topics, int(start_us), int(end_us), times, corrupted, walk.cut)


def _in_order(topic: Topic) -> tuple[Topic, bool]:
    """The rows of a topic in order of time, and whether some had a wrong time and were removed."""
    times = topic["TimeUS"]
    if not np.any(np.diff(times) < 0):
        return topic, False
    wrong = find_misdated(times, topic=True)
    # Messages of one instant may be logged out of order.
    order = np.flatnonzero(~wrong)[np.argsort(times[~wrong], kind="stable")]
    return {column: values[order] for column, values in topic.items()}, bool(wrong.any())


def _read_messages(
    path: Path,
    size: int,
    walk: BlockWalk,
    only: Collection[str] | None,
    thin: Callable[[Rows], Rows],
) -> dict[str, tuple[Rows, MessageFormat]]:
    """Rows and format by message name."""
    parts: dict[int, list[Rows]] = {}
    for at, data, starts in walk_blocks(path, size, walk):
        for form, rows in rows_by_type(data, at, starts, walk.forms):
            if only is None or form.name.rstrip("0123456789") in only or form.name in only:
                parts.setdefault(form.type, []).append(thin(rows))
    found: dict[str, tuple[Rows, MessageFormat]] = {}
    for number, some in parts.items():
        form, rows = walk.forms[number], some[0] if len(some) == 1 else np.concatenate(some)
        name = form.name if form.name not in found else f"{form.name}_{number}"
        found[name] = rows, form
    return found


def _columns(rows: Rows, form: MessageFormat) -> Topic:
    """The fields of a message as scaled columns, without those whose format is unreadable."""
    factors = {name: TYPES[code][1] for name, code in zip(form.columns, form.codes, strict=True)
               if code in TYPES}  # fmt: skip
    return {
        name: rows[name] if factor is None else rows[name] * factor
        for name, factor in factors.items()
    }


def _own_times(
    name: str, columns: Topic
) -> tuple[NDArray[np.int64] | None, NDArray[np.int64] | None]:
    """The time since boot in the messages and that of the receiver, in us; None without one."""
    # Old logs: TimeMS of a GPS message is the time of week, T the time since boot.
    old = "T" if name.startswith("GPS") else "TimeMS"
    times = {
        key: columns[key].astype(np.int64) * scale
        for key, scale in (("TimeUS", 1), (old, 1000), ("GMS", 1000))
        if key in columns and columns[key].dtype.kind in "iu"
    }
    return times.get("TimeUS", times.get(old)), times.get("GMS")


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
            if not 0 <= instance < MOST_INSTANCES:
                continue
            yield (name, instance), columns[key] == instance
    elif name[-1:].isdigit() and name[:-1] in NUMBERED:
        yield (name[:-1], int(name[-1]) - 1), slice(None)
    else:
        yield (name, 0), slice(None)
