"""Decode MAVLink frames to blocks of samples, the input of all detectors and estimators."""

import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.field_maps.field_map import TLOG, Columns, chosen_rows, rows_of
from analysis.samples import block
from analysis.samples.block import SPARE, Block, BlockPart, Indices, Stamps, join_parts
from analysis.samples.range_epochs import EpochAssembler
from analysis.samples.sample import Sample
from analysis.samples.wrapped_stamps import WRAPPED_MESSAGE, BootTime
from mavproxy_fault.rtcm.transport import PAYLOAD_TYPE, Reassembler
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.tlog import row_dtype

Orders = dict[str, Indices]

# The samples that each message gives.
SAMPLE_LINES = {
    name: samples
    for name, lines in TLOG.items()
    if (samples := [line for line in lines if line.target[0].isupper()])
}
# Fields with the time, and their microseconds.
TIMES = (("time_usec", 1), ("usec", 1), ("time_boot_ms", 1000))
# The messages with samples, and TUNNEL, which carries RTCM.
MESSAGES = (*SAMPLE_LINES, "TUNNEL")
# Messages on the simulator's clock, by which TUNNEL frames (without a timestamp) are dated.
STAMPED = ("HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION")
REPEATED = "DISTANCE_SENSOR"  # an autopilot sends on the measurements that a simulator gave it
_ROW_HEAD = struct.Struct("<qBBB")
_NO_ROWS, _NO_TUNNELS = np.empty(0, np.int64), np.empty(0, row_dtype("TUNNEL"))


def columns_of(frames: Iterable[Frame]) -> tuple[Columns, Orders]:
    """Frames as columns per message, and the index of each row's frame."""
    rows: dict[str, list[bytes]] = {}
    places: dict[str, list[int]] = {}
    for place, frame in enumerate(frames):
        name = frame.layout.name
        if name in MESSAGES:
            head = _ROW_HEAD.pack(0, frame.system, frame.component, frame.seq)
            length = frame.layout.length
            # MAVLink 2 truncates trailing zeros; a longer payload holds unknown extensions.
            rows.setdefault(name, []).append(head + frame.payload[:length].ljust(length, b"\0"))
            places.setdefault(name, []).append(place)
    columns = {name: np.frombuffer(b"".join(row), row_dtype(name)) for name, row in rows.items()}
    return columns, {name: np.array(found) for name, found in places.items()}


class Decoder:
    """Decodes the frames of one stream; keeps the state that spans frames (RTCM parts, clocks)."""

    __slots__ = ("_boot", "_fragments", "_newest_us", "_ranging")

    def __init__(self) -> None:
        self._fragments = Reassembler()
        self._ranging = EpochAssembler()
        self._boot = BootTime()
        self._newest_us: dict[int, int] = {}  # timestamp of each sender

    def decode(self, frames: Iterable[Frame]) -> Block:
        """The samples of some frames; messages without a measurement give none."""
        return self.decode_columns(*columns_of(frames))

    def decode_columns(
        self, columns: Mapping[str, NDArray[Any]], orders: Mapping[str, Indices]
    ) -> Block:
        """The samples of frames given as columns per message; `orders` are their indices (m,)."""
        parts = []
        stamped = [
            (_senders(columns[name]), orders[name], columns[name]["time_usec"].astype(np.int64))
            for name in STAMPED
            if name in columns
        ]
        simulators = {*self._newest_us}.union(*(sender.tolist() for sender, *_ in stamped))
        for name, rows in columns.items():
            order = orders[name]
            if name == REPEATED and simulators:
                measured = np.isin(_senders(rows), [*simulators])
                rows, order = rows[measured], order[measured]
            # Messages without a measurement give no rows.
            for part in read_samples(name, rows, order):
                if name == WRAPPED_MESSAGE:
                    t_us = self._boot.unwrap(part.t_us, part.order, columns, orders)
                    part = part._replace(t_us=t_us)
                parts.append(part)
        tunnels = columns.get("TUNNEL", _NO_TUNNELS)
        return join_parts(parts, self._tunnels(tunnels, orders.get("TUNNEL", _NO_ROWS), stamped))

    def _tunnels(
        self, rows: NDArray[Any], order: Indices, stamped: Sequence[tuple[Indices, Indices, Stamps]]
    ) -> list[tuple[int, Sample]]:
        """Epochs and ephemerides; `stamped` has senders, indices and timestamps of frames (m,)."""
        ours = np.flatnonzero(rows["payload_type"] == PAYLOAD_TYPE)
        # `take` copies complete records; indexing copies field by field and is slower.
        rows, order, sender = rows.take(ours), order[ours], _senders(rows)[ours]
        lengths = rows["payload_length"].tolist()
        found = [
            (row, message)
            for row, (number, payload) in enumerate(
                zip(sender.tolist(), rows["payload"], strict=True)
            )
            if lengths[row] <= len(payload)
            for message in self._fragments.add(payload[: lengths[row]].tobytes(), number)
        ]
        at = np.array([row for row, _ in found], np.int64)
        places, messages = order[at], [message for _, message in found]
        stamps_us = self._before(sender[at], places, stamped)
        return self._ranging.samples(zip(places.tolist(), messages, stamps_us, strict=True))

    def _before(
        self, sender: Indices, place: Indices, stamped: Sequence[tuple[Indices, Indices, Stamps]]
    ) -> list[int | None]:
        """The last timestamps that senders (k,) gave before the frames at `place` (k,)."""
        parts = [*stamped, (_NO_ROWS,) * 3]
        of, order, t_us = (np.concatenate(column) for column in zip(*parts, strict=True))
        found: list[int | None] = [None] * len(place)
        for number in np.union1d(of, sender).tolist():
            own, mine = of == number, np.flatnonzero(sender == number)
            by_place = np.argsort(order[own], kind="stable")
            # Before the first one of this block counts that of earlier blocks.
            stamps = [self._newest_us.get(number), *t_us[own][by_place].tolist()]
            at = np.searchsorted(order[own][by_place], place[mine])
            for i, row in zip(mine.tolist(), at.tolist(), strict=True):
                found[i] = stamps[row]
            if stamps[-1] is not None:
                self._newest_us[number] = stamps[-1]
        return found


def _senders(rows: NDArray[Any]) -> Indices:
    """One number (m,) per row for its system and component."""
    return np.asarray(rows["system"].astype(np.int64) << 8 | rows["component"])


def read_samples(name: str, rows: NDArray[Any], order: Indices) -> Iterator[BlockPart]:
    """The samples in the rows (n,) of a message; `order` (n,) are the rows' sort keys."""
    every = _columns(rows)
    for line in SAMPLE_LINES.get(name, ()):
        chosen = chosen_rows(line, every)
        if chosen is not None and not len(chosen):
            continue
        fields = every
        if chosen is not None and len(chosen) < len(rows):
            fields = _columns(rows.take(chosen))  # a tenth of the time of rows[chosen]
        values = rows_of(line, fields)
        if values is None:
            continue
        # `IMU#1` is a redundant sensor, for voting.
        kind, _, number = line.target.partition("#")
        if number:
            known = np.full((len(values), 2), (getattr(block, kind), int(number)), float)
            values = np.column_stack([known, values])
        key, scale = next(time for time in TIMES if time[0] in every)
        at = order if chosen is None else order[chosen]
        row_kind = SPARE if number else getattr(block, kind)
        yield BlockPart(row_kind, at, fields[key].astype(np.int64) * scale, values)


def _columns(rows: NDArray[Any]) -> Columns:
    return {name: rows[name] for name in rows.dtype.names or ()}
