"""MAVLink frames -> samples, the one form everything else works on."""

import struct
from collections import deque
from functools import lru_cache
from statistics import median_low

import numpy as np

from analysis.readers import READERS
from analysis.samples import (
    AirspeedSample,
    AttitudeSample,
    BaroSample,
    EphemerisSample,
    Epoch,
    GpsFix,
    ImuSample,
    IonosphereSample,
    MagSample,
    RangeSample,
    Sample,
    TruthSample,
    Vector,
    VisionSample,
)
from mavproxy_fault.wire.dialect import known
from mavproxy_fault.wire.ephemeris import decode_ephemeris
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.msm7 import Msm7, decode_msm7
from mavproxy_fault.wire.rtcm import Reassembler, message_number, tunnel_payload

__all__ = [
    "AirspeedSample",
    "AttitudeSample",
    "BaroSample",
    "Decoder",
    "EphemerisSample",
    "Epoch",
    "GpsFix",
    "ImuSample",
    "IonosphereSample",
    "MagSample",
    "RangeSample",
    "Sample",
    "TruthSample",
    "Vector",
    "VisionSample",
]

STAMPED = ("HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION")
HALF_WEEK_S = 302_400.0
WEEK_S = 604_800
OFFSETS_KEPT = 25


@lru_cache(maxsize=32)
def _packing(number: int) -> tuple[struct.Struct, int]:
    layout = known(number)
    code = "".join(f"{max(f.count, 1)}{f.code}" for f in layout.fields.values())
    return struct.Struct("<" + code), layout.length


def _unpack(frame: Frame) -> Vector:
    """All numbers (k,) of a frame in the order of the wire; cut zeros read as 0."""
    packing, length = _packing(frame.id)
    return np.array(packing.unpack(frame.payload.ljust(length, b"\0")), dtype=float)


class Decoder:
    """Frames of one stream to samples; holds what spans frames (RTCM fragments, clock offset).

    TUNNEL frames bear no stamp, so a pseudorange epoch gets its GPS time plus the median
    of the newest differences between the sender's clock and GPS time: a late frame keeps its true
    time, and so do the frames of a sender whose stamped messages pause.
    """

    __slots__ = ("_offsets", "_parts", "_reassemblers", "_stamps", "_week")

    def __init__(self) -> None:
        self._reassemblers: dict[tuple[int, int], Reassembler] = {}
        self._stamps: dict[tuple[int, int], int] = {}
        self._offsets: deque[int] = deque(maxlen=OFFSETS_KEPT)
        self._parts: list[Msm7] = []
        self._week: tuple[int, float] | None = None

    def decode(self, frame: Frame) -> list[Sample]:
        """The samples one frame holds; none for messages that carry no measurement."""
        name = frame.layout.name
        if name == "TUNNEL":
            return self._tunnel(frame)
        read = READERS.get(name)
        if read is None:
            return []
        samples = read(_unpack(frame), frame.system)
        if samples and name in STAMPED:
            self._stamps[frame.system, frame.component] = samples[-1].t_us
        return samples

    def _tunnel(self, frame: Frame) -> list[Sample]:
        payload = tunnel_payload(frame)
        if payload is None:
            return []
        sender = frame.system, frame.component
        samples: list[Sample] = []
        for message in self._reassemblers.setdefault(sender, Reassembler()).add(payload):
            samples += self._rtcm(message, self._stamps.get(sender))
        return samples

    def _rtcm(self, message: bytes, stamp_us: int | None) -> list[Sample]:
        number = message_number(message)
        try:
            if number in (1019, 1046):
                ephemeris = decode_ephemeris(message)
                self._week = ephemeris.week, ephemeris.toe_s
                return [EphemerisSample(stamp_us or 0, ephemeris)]
            if number in (1077, 1097):
                return self._ranges(decode_msm7(message), stamp_us)
        except ValueError:  # a peer's bad bytes are no sample
            return []
        return []

    def _ranges(self, part: Msm7, stamp_us: int | None) -> list[Sample]:
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
                pseudorange_m=np.array([x for part in parts for x in part.pseudorange_m]),
                doppler_mps=np.array([x for part in parts for x in part.doppler_mps]),
                cn0_dbhz=np.array([x for part in parts for x in part.cn0_dbhz]),
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
