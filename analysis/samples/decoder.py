"""Decode MAVLink frames to blocks of samples, the input of all detectors and estimators."""

import struct
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import Block, BlockPart, Indices, Stamps, join_parts
from analysis.samples.message_readers import SAMPLE_LINES, read_samples
from analysis.samples.range_epochs import EpochAssembler
from analysis.samples.sample import Sample
from analysis.samples.wrapped_stamps import WRAPPED_MESSAGE, BootTime
from mavproxy_fault.rtcm.transport import PAYLOAD_TYPE, Reassembler
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.tlog import Columns, row_dtype

Orders = dict[str, Indices]

# The messages with samples, and TUNNEL, which carries RTCM.
MESSAGES = (*SAMPLE_LINES, "TUNNEL")
# Messages on the simulator's clock, by which TUNNEL frames (without a timestamp) are dated.
STAMPED = ("HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION")
REPEATED = "DISTANCE_SENSOR"  # an autopilot sends on the measurements that a simulator gave it
_ROW_HEAD = struct.Struct("<qBBB")


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

    __slots__ = ("_boot", "_fragments", "_ranging", "_stamps")

    def __init__(self) -> None:
        self._fragments = Reassembler()
        self._ranging = EpochAssembler()
        self._boot = BootTime()
        self._stamps: dict[int, int] = {}

    def decode(self, frames: Iterable[Frame]) -> Block:
        """The samples of some frames; messages without a measurement give none."""
        return self.decode_columns(*columns_of(frames))

    def decode_columns(
        self, columns: Mapping[str, NDArray[Any]], orders: Mapping[str, Indices]
    ) -> Block:
        """The samples of frames given as columns per message; `orders` are their indices (m,)."""
        parts = []
        stamps = _Stamps(self._stamps)
        simulators = {*self._stamps} | {
            number for name in STAMPED if name in columns for number in _senders(columns[name])
        }
        for name, rows in columns.items():
            order = orders[name]
            if name == REPEATED and simulators:
                measured = np.isin(_senders(rows), [*simulators])
                rows, order = rows[measured], order[measured]
            # Messages without a measurement give no rows.
            for read in read_samples(name, rows):
                place, t_us = order[read.row], read.t_us
                if name == WRAPPED_MESSAGE:
                    t_us = self._boot.unwrap(t_us, place, columns, orders)
                parts.append(BlockPart(read.kind, place, t_us, read.values))
            if name in STAMPED:
                stamps.learn(_senders(rows), orders[name], rows["time_usec"].astype(np.int64))
        beside: list[tuple[int, Sample]] = []
        if "TUNNEL" in columns:
            # After the loop, since TUNNEL frames are dated by the timestamps of the entire block.
            beside = self._tunnels(columns["TUNNEL"], orders["TUNNEL"], stamps)
        self._stamps = stamps.newest()
        return join_parts(parts, beside)

    def _tunnels(
        self, rows: NDArray[Any], order: Indices, stamps: "_Stamps"
    ) -> list[tuple[int, Sample]]:
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
        stamps_us = stamps.before(sender[at], places)
        return self._ranging.samples(zip(places.tolist(), messages, stamps_us, strict=True))


def _senders(rows: NDArray[Any]) -> Indices:
    """One number (m,) per row for its system and component."""
    numbers: Indices = rows["system"].astype(np.int64) << 8 | rows["component"]
    return numbers


class _Stamps:
    """Newest timestamp of each sender before a frame; `before` holds those of earlier blocks."""

    def __init__(self, before: Mapping[int, int]) -> None:
        self._before = dict(before)
        self._parts: list[tuple[Indices, Indices, Stamps]] = []
        self._known: dict[int, tuple[Indices, Stamps]] = {}

    def learn(self, sender: Indices, order: Indices, t_us: Stamps) -> None:
        """Add timestamps (m,) of frames, with their senders and indices."""
        self._parts.append((sender, order, t_us))

    def before(self, sender: Indices, place: Indices) -> list[int | None]:
        """The last timestamps that senders (k,) gave before the frames at `place` (k,)."""
        found: list[int | None] = [None] * len(place)
        known = self._by_sender()
        for number in _distinct_senders(sender):
            order, t_us = known.get(number, _NO_STAMPS)
            mine = np.flatnonzero(sender == number)
            at = np.searchsorted(order, place[mine])  # 0: all of them are later
            newest = np.append(0, t_us)[at]
            earlier = self._before.get(number)
            for i, row, stamp_us in zip(mine.tolist(), at.tolist(), newest.tolist(), strict=True):
                found[i] = stamp_us if row else earlier
        return found

    def newest(self) -> dict[int, int]:
        """The last timestamp of every sender."""
        known = self._by_sender()
        # Timestamps of earlier blocks stay where there is no newer one.
        return self._before | {number: int(t_us[-1]) for number, (_, t_us) in known.items()}

    def _by_sender(self) -> dict[int, tuple[Indices, Stamps]]:
        """Frame indices and timestamps of each sender in order; call it after the last `learn`."""
        # Sorted once, at the first call.
        if self._known or not self._parts:
            return self._known
        sender, order, t_us = (np.concatenate(c) for c in zip(*self._parts, strict=True))
        by_place = np.argsort(order, kind="stable")
        sender, order, t_us = sender[by_place], order[by_place], t_us[by_place]
        numbers = _distinct_senders(sender)
        # Usually there is one vehicle on the link; then no masks are needed.
        if len(numbers) == 1:
            self._known = {numbers[0]: (order, t_us)}
        else:
            self._known = {n: (order[sender == n], t_us[sender == n]) for n in numbers}
        return self._known


_NO_STAMPS = np.empty(0, np.int64), np.empty(0, np.int64)


def _distinct_senders(sender: Indices) -> list[int]:
    """The distinct senders."""
    found: list[int] = np.flatnonzero(np.bincount(sender)).tolist()
    return found
