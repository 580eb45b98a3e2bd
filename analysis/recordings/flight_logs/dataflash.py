"""Read ArduPilot dataflash logs (.bin) as columns.

A message's columns are its fields as the log's own FMT messages name them, scaled as pymavlink
scales them, with `TimeUS` in microseconds (`log_time`), in old logs from `TimeMS`.
"""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.autopilot_log import AutopilotLog
from analysis.recordings.flight_logs.dataflash_blocks import (
    BlockWalk,
    read_formats,
    rows_by_type,
    walk_blocks,
)
from analysis.recordings.flight_logs.dataflash_formats import FIRST, MAGIC, TYPES, MessageFormat
from analysis.recordings.flight_logs.log_time import RowStamps, place_rows
from analysis.recordings.flight_logs.logged_rows import BlockRows, Rows, Thin, Topic, join_rows
from analysis.recordings.flight_logs.misdated_stamps import find_misdated
from mavproxy_fault.documents.errors import ConfigError, users_path
from mavproxy_fault.wire.written import written_bytes

HEAD = 4096  # bytes of a file that show its kind: text may stand in front of a log
NUMBERED = ("IMU", "MAG", "GPS", "GPA", "BARO", "BAT", "CURR")  # old logs: IMU2 is instance 1
RATES = {"R", "P", "Y", "RDes", "PDes", "YDes"}
# Fields with the number of the sensor or core.
INSTANCES = ("I", "C", "Instance", "Inst", "IMU")
MOST_INSTANCES = 32  # of motors; a larger number is a wrong byte


def is_dataflash(head: bytes) -> bool:
    """Whether a file that begins with these bytes (`HEAD` of them) is a dataflash log."""
    return head.startswith(MAGIC) or FIRST in head


class DataflashRows:
    """The rows of a dataflash log by message; of all messages, or `only` those with these names
    (without numbers of instances)."""

    def __init__(self, path: Path, only: Collection[str] | None) -> None:
        self._path, self._only, self._size = path, only, written_bytes(path)
        self.walk = BlockWalk(forms=read_formats(path, self._size))  # of the newest walk
        self._names: dict[int, str] = {}
        self.disordered = False  # whether rows with a wrong time were removed

    def blocks(self) -> Iterator[BlockRows]:
        """The rows of each block."""
        walk = self.walk = BlockWalk(forms=self.walk.forms)
        for at, data, starts in walk_blocks(self._path, self._size, walk):
            yield [
                (self._name(form), rows)
                for form, rows in rows_by_type(data, at, starts, walk.forms)
                if self._only is None
                or form.name.rstrip("0123456789") in self._only
                or form.name in self._only
            ]

    def _name(self, form: MessageFormat) -> str:
        """The name of a message; of two types with one name, the second has its number added."""
        if form.type not in self._names:
            taken = form.name in self._names.values()
            self._names[form.type] = f"{form.name}_{form.type}" if taken else form.name
        return self._names[form.type]

    def _columns(self, key: str, rows: Rows) -> Topic:
        """The fields of a message as scaled columns, without those whose format is unreadable."""
        form = next(self.walk.forms[n] for n, name in self._names.items() if name == key)
        factors = {name: TYPES[code][1] for name, code in zip(form.columns, form.codes, strict=True)
                   if code in TYPES}  # fmt: skip
        return {
            name: rows[name] if factor is None else rows[name] * factor
            for name, factor in factors.items()
        }

    def stamps(self, key: str, rows: Rows) -> RowStamps:
        """Places and stamps of rows: the time since boot and that of the receiver."""
        # Old logs: TimeMS of a GPS message is the time of week, T the time since boot.
        old = "T" if key.startswith("GPS") else "TimeMS"
        names = rows.dtype.names or ()
        times = {
            name: rows[name].astype(np.int64) * scale
            for name, scale in (("TimeUS", 1), (old, 1000), ("GMS", 1000))
            if name in names and rows.dtype[name].kind in "iu"
        }
        return RowStamps(rows["at"], times.get("TimeUS", times.get(old)), times.get("GMS"))

    def topics(
        self, key: str, rows: Rows, t_us: NDArray[np.int64]
    ) -> Iterator[tuple[tuple[str, int], Topic]]:
        """The columns of each instance in rows, in order of time."""
        every = self._columns(key, rows) | {"TimeUS": t_us}
        for name, some in _instances(key, every):
            topic, wrong = _in_order({column: values[some] for column, values in every.items()})
            self.disordered |= wrong
            yield name, topic


def read_dataflash(
    path: str | Path, only: Collection[str] | None = None, thin: Thin | None = None
) -> AutopilotLog:
    """Read a dataflash log, block by block: all messages, or `only` those with these names (without
    numbers of instances).

    Raises
    ------
    ConfigError
        If the file is not a dataflash log or holds no message with a time.
    """
    with users_path(path, "give the path of a .bin file"):
        logged = DataflashRows(Path(path), only)
        raw = join_rows(logged.blocks(), thin)
    walk = logged.walk
    times = place_rows({key: logged.stamps(key, rows) for key, rows in raw.items()}, walk.boots[1:])
    if not any(some.any() for some in times.times.values()):
        raise ConfigError(f"{path}: holds no message with a time; give a dataflash log of a flight")
    topics: dict[tuple[str, int], Topic] = {}
    for key, keep in times.keep.items():
        if keep.any():
            topics.update(logged.topics(key, raw.pop(key)[keep], times.times[key][keep]))
    _rates_in_degrees(topics)
    corrupted = walk.skipped_bytes > 0 or times.misdated or logged.disordered
    ends = [(topic["TimeUS"][0], topic["TimeUS"][-1]) for topic in topics.values()]
    start_us, end_us = min(first for first, _ in ends), max(last for _, last in ends)
    return AutopilotLog(
        "ardupilot", logged, thin is not None, topics, int(start_us), int(end_us), times,
        corrupted, walk.cut,
    )  # fmt: skip


def _in_order(topic: Topic) -> tuple[Topic, bool]:
    """The rows of a topic in order of time, and whether some had a wrong time and were removed."""
    times = topic["TimeUS"]
    if not np.any(np.diff(times) < 0):
        return topic, False
    wrong = find_misdated(times, topic=True)
    # Messages of one instant may be logged out of order.
    order = np.flatnonzero(~wrong)[np.argsort(times[~wrong], kind="stable")]
    return {column: values[order] for column, values in topic.items()}, bool(wrong.any())


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
