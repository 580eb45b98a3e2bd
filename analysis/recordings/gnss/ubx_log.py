"""Read u-blox logs: pseudoranges (UBX-RXM-RAWX) and navigation messages (UBX-RXM-SFRBX).

Other messages are skipped. After a frame with a wrong checksum or a missing end the search goes on
at its second byte, so a corrupted length hides no other frame. Ephemerides are read for GPS, QZSS
and Galileo; pseudoranges also for GLONASS and BeiDou, whose ephemerides must come from navigation
files [1]_.

A PX4 log holds these bytes if GPS_DUMP_COMM is set (message GpsDump) [2]_.

References
----------
.. [1] u-blox, F9 HPG 1.32 interface description (UBX-22008968): 3.2 and 3.4 (frame, checksum),
   3.17.4 (RXM-RAWX), 3.17.6 (RXM-SFRBX); 1.5.3 (signal identifiers).
.. [2] PX4, msg/GpsDump.msg: up to 79 bytes a message, the top bit of `len` set on those sent to
   the receiver.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from analysis.recordings.flight_logs.ulog import read_ulog
from analysis.recordings.gnss.log_bytes import read_log_bytes
from analysis.recordings.gnss.navigation_words import (
    WEEK_S,
    gps_ephemeris,
    inav_ephemeris,
    klobuchar_coefficients,
    parse_inav_word,
    parse_subframe,
)
from analysis.recordings.gnss.rinex_observations import (
    SECOND,
    CodeObservation,
    carrier_of,
    epoch_of,
)
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

SYNC = b"\xb5b"
OVERHEAD_BYTES = 8  # bytes of a frame outside its payload
RAWX, SFRBX = b"\x02\x15", b"\x02\x13"
HEAD = np.dtype([("tow_s", "<f8"), ("week", "<u2"), ("leap_s", "i1"), ("count", "u1"), ("", "V4")])
RANGE = np.dtype(
    [("pseudorange_m", "<f8"), ("phase", "<f8"), ("doppler_hz", "<f4")]
    + [(name, "u1") for name in ("system", "satellite", "signal", "slot")]
    + [("lock_ms", "<u2"), ("cn0_dbhz", "u1"), ("", "V3"), ("status", "u1"), ("", "V1")]
)
RANGE_VALID = 1
# By u-blox system and signal number: RINEX letter and code, carrier (GLONASS: channel 0).
SIGNALS = {
    (number, signal): (code[0], code[1:], carrier_of(code[0], code[1:]))
    for number, codes in {
        0: {0: "G1C", 3: "G2L", 4: "G2S", 6: "G5I", 7: "G5Q"},
        2: {0: "E1C", 1: "E1B", 3: "E5I", 4: "E5Q", 5: "E7I", 6: "E7Q"},
        3: {0: "C2I", 1: "C2I", 2: "C7I", 3: "C7I", 4: "C6I", 7: "C5P"},
        5: {0: "J1C", 4: "J2S", 5: "J2L", 8: "J5I", 9: "J5Q"},
        6: {0: "R1C", 2: "R2C"},
    }.items()
    for signal, code in codes.items()
}
CHANNEL_ZERO = 7  # offset of GLONASS channel numbers
UNKNOWN_SATELLITE = 255
HEAD_BYTES = 8  # header of SFRBX before its words; that of RAWX is longer
GPS, GALILEO, QZSS = 0, 2, 5
LETTERS = {GPS: "G", GALILEO: "E", QZSS: "J"}
# C/A; E1 and E5b (0 on receivers with E1 only). Other signals carry other messages.
MESSAGE_SIGNALS = {GPS: (0,), GALILEO: (0, 1, 5, 6), QZSS: (0,)}
Broadcast = EphemerisSample | IonosphereSample
ULOG = ".ulg"
TO_RECEIVER = 0x80  # bit of `len` of a GpsDump
MAX_DUMP_BYTES = 79


def read_ubx(path: Path) -> tuple[list[Epoch], list[Broadcast]]:
    """All epochs of a log; and its ephemerides and Klobuchar coefficients, with timestamp 0.

    Raises
    ------
    ConfigError
        If the log cannot be read or holds no RXM-RAWX.
    """
    payloads: dict[bytes, list[bytes]] = {RAWX: [], SFRBX: []}
    dumped = path.name.lower().endswith(ULOG)
    data = _dumped(path) if dumped else read_log_bytes(path, "a u-blox log")
    for kind, payload in _frames(data):
        # With a correct checksum a shorter payload is valid: the receiver has no fix.
        if len(payload) >= HEAD_BYTES:
            payloads[kind].append(payload)
    if not payloads[RAWX]:
        raise ConfigError(
            f"{path}: has no complete UBX-RXM-RAWX; enable it and UBX-RXM-SFRBX on the receiver"
        )
    found = (rawx_epoch(payload) for payload in payloads[RAWX])
    epochs = [epoch for epoch in found if epoch is not None]
    near_s = epochs[0].t_us * 1e-6 if epochs else 0.0
    return epochs, list(_broadcasts(payloads[SFRBX], near_s))


def _dumped(path: Path) -> bytes:
    """The bytes that the first receiver of a PX4 log sent."""
    dump = read_ulog(path).topics.get(("gps_dump", 0))
    if dump is None:
        raise ConfigError(f"{path}: has no gps_dump; set GPS_DUMP_COMM to 1 before the flight")
    names = [f"data[{i}]" for i in range(MAX_DUMP_BYTES)]
    for name in ("len", *names):
        if name not in dump or dump[name].dtype != np.uint8:
            raise ConfigError(
                f"{path}: gps_dump has no bytes {name}: the log is corrupted or not from PX4; "
                f"a dump has len and data[0] to {names[-1]}"
            )
    # Two receivers share the topic; older PX4 versions log a single one.
    receiver = dump.get("instance", np.zeros_like(dump["len"]))
    first = (receiver == receiver.min()) & (dump["len"] < TO_RECEIVER)
    data = np.column_stack([dump[name] for name in names])[first]
    # A corrupted length takes the full message; checksums of the frames catch the rest.
    return bytes(data[np.arange(MAX_DUMP_BYTES) < dump["len"][first, None]])


def _frames(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Class and id, and payload, of each complete RAWX and SFRBX frame."""
    at = data.find(SYNC)
    while at >= 0:
        kind, length = data[at + 2 : at + 4], int.from_bytes(data[at + 4 : at + 6], "little")
        end = at + OVERHEAD_BYTES + length
        body, summed = data[at + 2 : end - 2], data[end - 2 : end]
        # A false start or a corrupted length must not hide the frames after it.
        if kind in (RAWX, SFRBX) and end <= len(data) and _checksum(body) == summed:
            yield kind, data[at + 6 : end - 2]
            at = end - 1
        at = data.find(SYNC, at + 1)


def _checksum(body: bytes) -> bytes:
    """8-bit Fletcher checksum: the sum of the bytes, and the sum of its partial sums."""
    values = np.frombuffer(body, np.uint8).astype(np.int64)
    weights = np.arange(len(values), 0, -1)
    return bytes([int(values.sum()) & 255, int(values @ weights) & 255])


def rawx_epoch(payload: bytes) -> Epoch | None:
    """The epoch of a RAWX message; None if the receiver has no time or no valid pseudorange."""
    count = (len(payload) - HEAD.itemsize) // RANGE.itemsize
    if count < 0:
        return None
    head = np.frombuffer(payload, HEAD, 1)[0]
    tow_s, week = float(head["tow_s"]), int(head["week"])
    if week == 0 or not 0.0 <= tow_s < WEEK_S:
        return None
    rows: tuple[dict[str, CodeObservation], ...] = {}, {}
    channels: dict[str, int] = {}
    for row in np.frombuffer(payload, RANGE, count, HEAD.itemsize):
        signal = SIGNALS.get((int(row["system"]), int(row["signal"])))
        number = int(row["satellite"])
        if signal is None or number == UNKNOWN_SATELLITE or not row["status"] & RANGE_VALID:
            continue
        letter, code, carrier_hz = signal
        name = f"{letter}{number:02d}"
        values = float(row["pseudorange_m"]), float(row["doppler_hz"]), float(row["cn0_dbhz"])
        rows[code in SECOND[letter]].setdefault(name, (name, values, carrier_hz, code))
        if letter == "R":
            channels[name] = int(row["slot"]) - CHANNEL_ZERO
    return epoch_of(week, tow_s, rows[0].values(), channels, rows[1])


def _broadcasts(payloads: list[bytes], near_s: float) -> Iterator[Broadcast]:
    """Ephemerides and ionosphere of all satellites, each once per change."""
    known: dict[str, dict[int, bytes]] = {}  # the newest subframes or words by number
    newest: dict[str, Ephemeris] = {}
    for payload in payloads:
        system, number, signal, _, count = payload[:5]
        short = len(payload) < HEAD_BYTES + 4 * count
        if short or signal not in MESSAGE_SIGNALS.get(system, ()):
            continue
        words = np.frombuffer(payload, "<u4", count, HEAD_BYTES).tolist()
        parse, decode = (
            (parse_inav_word, inav_ephemeris)
            if system == GALILEO
            else (parse_subframe, gps_ephemeris)
        )
        if (part := parse(words)) is None:
            continue
        name = f"{LETTERS[system]}{number:02d}"
        parts = known.setdefault(name, {})
        parts[part[0]] = part[1]
        ephemeris = decode(name, parts, near_s)
        # QZSS coefficients are valid for Japan only.
        if system == GPS and (ionosphere := klobuchar_coefficients(*part)) is not None:
            yield IonosphereSample(0, *ionosphere)
        if ephemeris is not None and newest.get(ephemeris.satellite) != ephemeris:
            newest[ephemeris.satellite] = ephemeris
            yield EphemerisSample(0, ephemeris)
