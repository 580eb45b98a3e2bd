"""MAVLink frames -> samples, the one form everything else works on."""

import struct
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import Block, BlockPart, Indices, Stamps, join_parts
from analysis.samples.message_readers import READERS
from analysis.samples.range_epochs import EpochAssembler
from analysis.samples.sample import Sample
from analysis.samples.wrapped_stamps import WRAPPED_MESSAGE, BootTime
from mavproxy_fault.rtcm.transport import PAYLOAD_TYPE
from mavproxy_fault.rtcm.tunnel_columns import Assembler
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.tlog import Columns, row_dtype

Orders = dict[str, Indices]

# READERS and, besides, the message that carries RTCM.
MESSAGES = (*READERS, "TUNNEL")
# The stamps that a TUNNEL frame is dated by: the messages of the simulator's own clock.
STAMPED = ("HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION")
_ROW_HEAD = struct.Struct("<qBBB")


def columns_of(frames: Iterable[Frame]) -> tuple[Columns, Orders]:
    """Frames as the columns of a log, and which frame each row was."""
    rows: dict[str, list[bytes]] = {}
    places: dict[str, list[int]] = {}
    for place, frame in enumerate(frames):
        name = frame.layout.name
        if name in MESSAGES:
            head = _ROW_HEAD.pack(0, frame.system, frame.component, frame.seq)
            length = frame.layout.length
            # MAVLink 2 cuts zeros off the end of a payload; a longer one holds unknown extensions.
            rows.setdefault(name, []).append(head + frame.payload[:length].ljust(length, b"\0"))
            places.setdefault(name, []).append(place)
    columns = {name: np.frombuffer(b"".join(row), row_dtype(name)) for name, row in rows.items()}
    return columns, {name: np.array(found) for name, found in places.items()}


class Decoder:
    """Frames of one stream to samples; holds what spans frames."""

    __slots__ = ("_assembler", "_boot", "_ranging", "_stamps")

    def __init__(self) -> None:
        self._assembler = Assembler()
        self._ranging = EpochAssembler()
        self._boot = BootTime()
        self._stamps: dict[int, int] = {}

    def decode(self, frames: Iterable[Frame]) -> Block:
        """The samples that some frames hold; none for messages that carry no measurement."""
        return self.decode_columns(*columns_of(frames))

    def decode_columns(
        self, columns: Mapping[str, NDArray[Any]], orders: Mapping[str, Indices]
    ) -> Block:
        """The samples of frames given by message, with the place (m,) of each among all frames."""
        parts = []
        stamps = _Stamps(self._stamps)
        for name, rows in columns.items():
            # A message without a reader, or without a measurement, gives no rows.
            for read in READERS[name](rows) if name in READERS else ():
                place, t_us = orders[name][read.row], read.t_us
                if name == WRAPPED_MESSAGE:
                    t_us = self._boot.unwrap(t_us, place, columns, orders)
                parts.append(BlockPart(read.kind, place, t_us, read.values))
            if name in STAMPED:
                stamps.learn(_senders(rows), orders[name], rows["time_usec"].astype(np.int64))
        beside: list[tuple[int, Sample]] = []
        if "TUNNEL" in columns:
            # After the loop: tunnels are dated by the stamps of the whole block.
            beside = self._tunnels(columns["TUNNEL"], orders["TUNNEL"], stamps)
        self._stamps = stamps.newest()
        return join_parts(parts, beside)

    def _tunnels(
        self, rows: NDArray[Any], order: Indices, stamps: "_Stamps"
    ) -> list[tuple[int, Sample]]:
        ours = np.flatnonzero(rows["payload_type"] == PAYLOAD_TYPE)
        # Records are copied whole by `take`, field by field when indexed.
        rows, order, sender = rows.take(ours), order[ours], _senders(rows)[ours]
        payload = np.ascontiguousarray(rows["payload"])
        messages = self._assembler.add(sender, payload, rows["payload_length"].astype(np.int64))
        places = order[messages.row]
        stamps_us = stamps.before(sender[messages.row], places)
        return self._ranging.samples(messages, places.tolist(), stamps_us)


def _senders(rows: NDArray[Any]) -> Indices:
    """A number (m,) of system and component of each row."""
    numbers: Indices = rows["system"].astype(np.int64) << 8 | rows["component"]
    return numbers


class _Stamps:
    """The newest stamp of each sender before some frame; `before` holds those of earlier blocks."""

    def __init__(self, before: Mapping[int, int]) -> None:
        self._before = dict(before)
        self._parts: list[tuple[Indices, Indices, Stamps]] = []
        self._known: dict[int, tuple[Indices, Stamps]] = {}

    def learn(self, sender: Indices, order: Indices, t_us: Stamps) -> None:
        """Stamps (m,) of frames, whose they are, and their places."""
        self._parts.append((sender, order, t_us))

    def before(self, sender: Indices, place: Indices) -> list[int | None]:
        """The stamps that senders (k,) gave last before some places."""
        found: list[int | None] = [None] * len(place)
        known = self._by_sender()
        for number in _distinct_senders(sender):
            order, t_us = known.get(number, _NO_STAMPS)
            mine = np.flatnonzero(sender == number)
            at = np.searchsorted(order, place[mine])  # 0: all of them came later
            newest = np.append(0, t_us)[at]
            earlier = self._before.get(number)
            for i, row, stamp_us in zip(mine.tolist(), at.tolist(), newest.tolist(), strict=True):
                found[i] = stamp_us if row else earlier
        return found

    def newest(self) -> dict[int, int]:
        """The last stamp of every sender."""
        known = self._by_sender()
        # Of earlier blocks what no newer stamp replaces.
        return self._before | {number: int(t_us[-1]) for number, (_, t_us) in known.items()}

    def _by_sender(self) -> dict[int, tuple[Indices, Stamps]]:
        """Places and stamps of each sender in order; asked for when all have been learnt."""
        # Sorted once, at the first question.
        if self._known or not self._parts:
            return self._known
        sender, order, t_us = (np.concatenate(c) for c in zip(*self._parts, strict=True))
        by_place = np.argsort(order, kind="stable")
        sender, order, t_us = sender[by_place], order[by_place], t_us[by_place]
        numbers = _distinct_senders(sender)
        # One vehicle on the link is the rule: no masks then.
        if len(numbers) == 1:
            self._known = {numbers[0]: (order, t_us)}
        else:
            self._known = {n: (order[sender == n], t_us[sender == n]) for n in numbers}
        return self._known


_NO_STAMPS = np.empty(0, np.int64), np.empty(0, np.int64)


def _distinct_senders(sender: Indices) -> list[int]:
    """The different senders."""
    found: list[int] = np.flatnonzero(np.bincount(sender)).tolist()
    return found
