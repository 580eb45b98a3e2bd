"""Dataflash logs for tests: u-blox's RXM-RAWX as ArduPilot logs it.

Formats and labels: ArduPilot, libraries/AP_GPS/LogStructure.h; FMT itself: AP_Logger's.
"""

from collections.abc import Sequence
from struct import pack, unpack_from

HEAD = b"\xa3\x95"
GRXH, GRXS = 173, 174
FORMATS = {
    GRXH: ("GRXH", "QdHbBB", "TimeUS,rcvTime,week,leapS,numMeas,recStat"),
    GRXS: (
        "GRXS",
        "QddfBBBHBBBBB",
        "TimeUS,prMes,cpMes,doMes,gnss,sv,freq,lock,cno,prD,cpD,doD,trk",
    ),
}
LENGTHS = {0x80: 89, GRXH: 24, GRXS: 41}


def raw_log(payloads: Sequence[bytes], apart_us: int = 1_000_000) -> bytes:
    """A log of RAWX messages, each at one time."""
    fmt = (0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    log = b"".join(_format(*given) for given in (fmt, *((k, *v) for k, v in FORMATS.items())))
    for i, payload in enumerate(payloads, 1):
        tow_s, week, leap_s, count, status = unpack_from("<dHbBB", payload)
        head = pack("<QdHbBB", i * apart_us, tow_s, week, leap_s, count, status)
        log += HEAD + bytes([GRXH]) + head
        for at in range(16, 16 + 32 * count, 32):
            # The signal, byte 22, is the one field that is not logged.
            measured = payload[at : at + 22] + payload[at + 23 : at + 31]
            log += HEAD + bytes([GRXS]) + pack("<Q", i * apart_us) + measured
    return log


def _format(kind: int, name: str, fields: str, labels: str) -> bytes:
    words = pack("<4s16s64s", name.encode(), fields.encode(), labels.encode())
    return HEAD + bytes([0x80, kind, LENGTHS[kind]]) + words
