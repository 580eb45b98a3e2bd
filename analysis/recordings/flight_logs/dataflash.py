"""Read ArduPilot dataflash logs (.bin) as columns.

A message's columns are its fields as the log's own FMT messages name them, scaled as pymavlink
scales them, with `TimeUS` in microseconds since boot. In old logs it is computed from `TimeMS`; a
message without a time gets that of the message before it. A second boot in one file continues the
time of the first.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.dataflash_blocks import (
    BlockWalk,
    read_formats,
    rows_by_type,
    walk_blocks,
)
from analysis.recordings.flight_logs.dataflash_formats import FIRST, MAGIC, TYPES, MessageFormat
from analysis.recordings.flight_logs.misdated_stamps import find_misdated, find_restarts
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.written import written_bytes

Topic = dict[str, NDArray[Any]]
Rows = NDArray[np.void]
HEAD = 4096  # bytes of a file that show its kind: text may stand in front of a log
LATEST_US = 10**15  # 31 years after boot
PAUSE_US = 1_000_000  # between two boots in one file, whose real pause is not logged
NUMBERED = ("IMU", "MAG", "GPS", "GPA", "BARO", "BAT", "CURR")  # old logs: IMU2 is instance 1
RATES = {"R", "P", "Y", "RDes", "PDes", "YDes"}
# Fields with the number of the sensor or core.
INSTANCES = ("I", "C", "Instance", "Inst", "IMU")
MOST_INSTANCES = 32  # of motors; a larger number is a wrong byte


@dataclass(frozen=True, slots=True)
class DataflashFile:
    """Contents of a dataflash log.

    Attributes
    ----------
    topics : dict
        Columns, with `TimeUS`, by message name and instance (from 0).
    start_us, end_us : int
        First and last time.
    restarts : int
        Boots after the first one.
    corrupted : bool
        Whether bytes or messages with an impossible time were skipped.
    cut : bool
        Whether the file ends within a message.
    """

    topics: Mapping[tuple[str, int], Topic]
    start_us: int
    end_us: int
    restarts: int
    corrupted: bool
    cut: bool


def is_dataflash(head: bytes) -> bool:
    """Whether a file that begins with these bytes (`HEAD` of them) is a dataflash log."""
    return head.startswith(MAGIC) or FIRST in head


def read_dataflash(
    path: str | Path,
    only: Collection[str] | None = None,
    thin: Callable[[Rows], Rows] = lambda rows: rows,
) -> DataflashFile:
    """Read a dataflash log, block by block.

    Parameters
    ----------
    path : str or Path
    only : collection of str, optional
        Names of the messages to keep, without numbers of instances; all by default.
    thin : callable
        Chooses the rows (k,) to keep of those (n,) of one message in a block.

    Raises
    ------
    ConfigError
        If the file is not a dataflash log or holds no message with a time.
    """
    path = Path(path)
    try:
        size = written_bytes(path)
        walk = BlockWalk(forms=read_formats(path, size))
        raw, times = _read_messages(path, size, walk, only, thin)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give the path of a .bin file") from error
    if len(times[0]) == 0:
        raise ConfigError(f"{path}: holds no message with a time; give a dataflash log of a flight")
    wrong = find_misdated(times[1])
    places, corrupted = times[0][wrong], walk.skipped_bytes > 0 or bool(wrong.any())
    times = times[0][~wrong], times[1][~wrong].astype(np.int64)
    boots, shifts = _boots(times)
    times = times[0], times[1] + shifts[np.searchsorted(boots, times[0], "right")]
    topics: dict[tuple[str, int], Topic] = {}
    for name, (rows, form) in raw.items():
        rows = rows[~np.isin(rows["at"], places)]
        columns = _columns(rows, form)
        own = _own_time(name, columns)
        if own is None:
            own = times[1][np.maximum(np.searchsorted(times[0], rows["at"]) - 1, 0)]
        else:
            own = own + shifts[np.searchsorted(boots, rows["at"], "right")]
        columns["TimeUS"] = own
        for key, some in _instances(name, columns) if len(own) else ():
            topic = {column: values[some] for column, values in columns.items()}
            topics[key], some_wrong = _in_order(topic)
            corrupted = corrupted or some_wrong
    _rates_in_degrees(topics)
    stamps = times[1]
    return DataflashFile(
        topics, int(stamps.min()), int(stamps.max()), len(boots), corrupted, walk.cut
    )


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
) -> tuple[dict[str, tuple[Rows, MessageFormat]], tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Rows and format by message name; offsets and times of all kept messages with a time."""
    parts: dict[int, list[Rows]] = {}
    for at, data, starts in walk_blocks(path, size, walk):
        for form, rows in rows_by_type(data, at, starts, walk.forms):
            if only is None or form.name.rstrip("0123456789") in only or form.name in only:
                parts.setdefault(form.type, []).append(thin(rows))
    found: dict[str, tuple[Rows, MessageFormat]] = {}
    stamps = [(np.empty(0, np.int64), np.empty(0, np.int64))]
    for number, some in parts.items():
        form, rows = walk.forms[number], some[0] if len(some) == 1 else np.concatenate(some)
        name = form.name if form.name not in found else f"{form.name}_{number}"
        found[name] = rows, form
        own = _own_time(name, {key: rows[key] for key in form.columns})
        if own is not None:
            stamps.append((rows["at"], own))
    place, time = (np.concatenate(columns) for columns in zip(*stamps, strict=True))
    order = np.argsort(place, kind="stable")
    return found, (place[order], time[order])


def _columns(rows: Rows, form: MessageFormat) -> Topic:
    """The fields of a message as scaled columns, without those whose format is unreadable."""
    factors = {name: TYPES[code][1] for name, code in zip(form.columns, form.codes, strict=True)
               if code in TYPES}  # fmt: skip
    return {
        name: rows[name] if factor is None else rows[name] * factor
        for name, factor in factors.items()
    }


def _boots(
    times: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Offsets (k,) of the first messages of later boots; shifts (k + 1,) of each boot's times that
    place the boots one after another."""
    again = find_restarts(times[1])
    shifts = [0]
    begins = [0, *again.tolist(), len(times[1])]
    for begin, end, after in zip(begins, begins[1:], begins[2:], strict=False):
        newest = int(times[1][begin:end].max()) + shifts[-1]
        shifts.append(newest + PAUSE_US - int(times[1][end:after].min()))
    return times[0][again], np.array(shifts, np.int64)


def _own_time(name: str, columns: Topic) -> NDArray[np.int64] | None:
    """The time since boot in the messages, in microseconds; None if they have none."""
    # Old logs: TimeMS of a GPS message is the time of week, T the time since boot.
    old = "T" if name.startswith("GPS") else "TimeMS"
    key, scale = ("TimeUS", 1) if "TimeUS" in columns else (old, 1000)
    if key not in columns or columns[key].dtype.kind not in "iu":
        return None
    # Clipped: sums and differences of wrong times must not overflow.
    return np.clip(columns[key].astype(np.int64), -1, LATEST_US // scale) * scale


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
