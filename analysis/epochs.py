"""MAVLink frames -> samples, the one form everything else works on."""

import struct
from collections import deque
from collections.abc import Iterable, Mapping
from statistics import median_low
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.block import Block, Indices, Part, Stamps, joined
from analysis.readers import READERS
from analysis.samples import EphemerisSample, Epoch, Sample
from mavproxy_fault.wire.ephemeris import decode_ephemeris
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.ranges import Ranges, quick_crc24q, read_ranges
from mavproxy_fault.wire.rtcm import PAYLOAD_TYPE, Reassembler, message_number
from mavproxy_fault.wire.tlog import Columns, row_dtype

Orders = dict[str, Indices]
Sender = tuple[int, int]

MESSAGES = (*READERS, "TUNNEL")
STAMPED = ("HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION")
HALF_WEEK_S = 302_400.0
WEEK_S = 604_800
OFFSETS_KEPT = 25
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
            rows.setdefault(name, []).append(head + frame.payload[:length].ljust(length, b"\0"))
            places.setdefault(name, []).append(place)
    columns = {name: np.frombuffer(b"".join(row), row_dtype(name)) for name, row in rows.items()}
    return columns, {name: np.array(found) for name, found in places.items()}


class Decoder:
    """Frames of one stream to samples; holds what spans frames (RTCM fragments, clock offset).

    TUNNEL frames bear no stamp, so a pseudorange epoch gets its GPS time plus the median
    of the newest differences between the sender's clock and GPS time: a late frame keeps its true
    time, and so do the frames of a sender whose stamped messages pause.
    """

    __slots__ = ("_offsets", "_parts", "_reassemblers", "_stamps", "_week")

    def __init__(self) -> None:
        self._reassemblers: dict[Sender, Reassembler] = {}
        self._stamps: dict[Sender, int] = {}
        self._offsets: deque[int] = deque(maxlen=OFFSETS_KEPT)
        self._parts: list[Ranges] = []
        self._week: tuple[int, float] | None = None

    def decode(self, frames: Iterable[Frame]) -> Block:
        """The samples that some frames hold; none for messages that carry no measurement."""
        return self.columns(*columns_of(frames))

    def columns(self, columns: Mapping[str, NDArray[Any]], orders: Mapping[str, Indices]) -> Block:
        """The samples of frames given by message, with the place (m,) of each among all frames."""
        parts = []
        stamps = _Stamps(self._stamps)
        for name, rows in columns.items():
            for read in READERS[name](rows) if name in READERS else ():
                order = orders[name][read.row]
                parts.append(Part(read.kind, order, read.t_us, read.values))
                if name in STAMPED:
                    stamps.learn(rows[read.row], order, read.t_us)
        beside: list[tuple[int, Sample]] = []
        if "TUNNEL" in columns:
            beside = self._tunnels(columns["TUNNEL"], orders["TUNNEL"], stamps)
        self._stamps = stamps.newest()
        return joined(parts, beside)

    def _tunnels(
        self, rows: NDArray[Any], order: Indices, stamps: "_Stamps"
    ) -> list[tuple[int, Sample]]:
        found: list[tuple[int, Sample]] = []
        ours = np.flatnonzero(rows["payload_type"] == PAYLOAD_TYPE)
        fields = ("system", "component", "payload_length")
        senders = zip(ours.tolist(), *(rows[name][ours].tolist() for name in fields), strict=True)
        payloads = np.ascontiguousarray(rows["payload"])
        for row, system, component, length in senders:
            sender, place = (system, component), int(order[row])
            reassembler = self._reassembler(sender)
            if length > payloads.shape[1]:
                continue
            for message in reassembler.add(payloads[row, :length].tobytes()):
                stamp_us = stamps.before(sender, place)
                found += [(place, sample) for sample in self._rtcm(message, stamp_us)]
        return found

    def _reassembler(self, sender: Sender) -> Reassembler:
        if sender not in self._reassemblers:
            self._reassemblers[sender] = Reassembler(quick_crc24q)
        return self._reassemblers[sender]

    def _rtcm(self, message: bytes, stamp_us: int | None) -> list[Sample]:
        number = message_number(message)
        try:
            if number in (1019, 1046):
                ephemeris = decode_ephemeris(message)
                self._week = ephemeris.week, ephemeris.toe_s
                return [EphemerisSample(stamp_us or 0, ephemeris)]
            if number in (1077, 1097):
                return self._ranges(read_ranges(message), stamp_us)
        except ValueError:  # a peer's bad bytes are no sample
            return []
        return []

    def _ranges(self, part: Ranges, stamp_us: int | None) -> list[Sample]:
        """Collect the messages of one epoch; the epoch when its last one is here."""
        done: list[Sample] = []
        if self._parts and self._parts[0].tow_s != part.tow_s:
            done = self._epoch(stamp_us)
        self._parts.append(part)
        return done if part.more else done + self._epoch(stamp_us)

    def _epoch(self, stamp_us: int | None) -> list[Sample]:
        parts, self._parts = self._parts, []
        tow_s = parts[0].tow_s
        week = self._full_week(tow_s)
        gps_us = round((week * WEEK_S + tow_s) * 1e6)
        if stamp_us is not None:
            offset_us = stamp_us - gps_us
            if self._offsets and abs(offset_us - self._offsets[-1]) > WEEK_S * 1_000_000 // 2:
                self._offsets.clear()  # the week has become known
            self._offsets.append(offset_us)
        offset_us = median_low(self._offsets) if self._offsets else 0
        return [
            Epoch(
                t_us=gps_us + offset_us,
                week=week,
                tow_s=tow_s,
                satellites=tuple(name for part in parts for name in part.satellites),
                pseudorange_m=np.concatenate([part.pseudorange_m for part in parts]),
                doppler_mps=np.concatenate([part.doppler_mps for part in parts]),
                cn0_dbhz=np.concatenate([part.cn0_dbhz for part in parts]),
            )
        ]

    def _full_week(self, tow_s: float) -> int:
        """MSM gives no week; the newest ephemeris does (0 before there is one)."""
        if self._week is None:
            return 0
        week, toe_s = self._week
        if tow_s - toe_s > HALF_WEEK_S:
            return week - 1
        return week + 1 if toe_s - tow_s > HALF_WEEK_S else week


class _Stamps:
    """The newest stamp of each sender before some frame."""

    def __init__(self, before: Mapping[Sender, int]) -> None:
        self._before = dict(before)
        self._parts: dict[Sender, list[tuple[Indices, Stamps]]] = {}
        self._known: dict[Sender, tuple[Indices, Stamps]] = {}

    def learn(self, rows: NDArray[Any], order: Indices, t_us: Stamps) -> None:
        """Stamps (m,) of rows and their places."""
        numbers = rows["system"].astype(int) << 8 | rows["component"]
        for number in np.unique(numbers).tolist():
            mine = numbers == number
            parts = self._parts.setdefault((number >> 8, number & 0xFF), [])
            parts.append((order[mine], t_us[mine]))

    def before(self, sender: Sender, place: int) -> int | None:
        """The stamp that a sender gave last before a place."""
        if sender in self._parts:
            order, t_us = self._sorted(sender)
            at = int(np.searchsorted(order, place))
            if at:
                return int(t_us[at - 1])
        return self._before.get(sender)

    def newest(self) -> dict[Sender, int]:
        """The last stamp of every sender."""
        return self._before | {sender: int(self._sorted(sender)[1][-1]) for sender in self._parts}

    def _sorted(self, sender: Sender) -> tuple[Indices, Stamps]:
        if sender not in self._known:
            order, t_us = (
                np.concatenate(column) for column in zip(*self._parts[sender], strict=True)
            )
            by_place = np.argsort(order, kind="stable")
            self._known[sender] = order[by_place], t_us[by_place]
        return self._known[sender]
