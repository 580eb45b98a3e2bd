"""Read Septentrio logs (SBF): pseudoranges of MeasEpoch, and decoded ephemerides.

The first signal of a satellite has absolute values, the others are differences from it; L1 may be
either [1]_. Other blocks are skipped. After a block with a wrong checksum the search goes on at its
second byte, so a corrupted length hides no other block.

References
----------
.. [1] Septentrio, mosaic-X5 and PolaRx5 reference guides, 4.1.1 (blocks, checksum), 4.1.10 (signal
   numbers), 4.2.1 (MeasEpoch).
"""

import math
from binascii import crc_hqx
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from struct import Struct
from typing import NamedTuple

from analysis.recordings.gnss.log_bytes import read_log_bytes
from analysis.recordings.gnss.navigation_words import WEEK_S
from analysis.recordings.gnss.rinex_observations import (
    SECOND,
    CodeObservation,
    carrier_of,
    epoch_of,
)
from analysis.recordings.gnss.sbf_orbits import ORBITS, block_number, read_orbit, satellite_name
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample
from mavproxy_fault.documents.errors import ConfigError

SYNC = b"$@"
OVERHEAD_BYTES = 8  # bytes of a block outside its payload
MEAS_EPOCH = 4027
# Time in ms and week; number of sub-blocks, sizes of both kinds; flags.
HEAD = Struct("<IHBBBB2x")
# First signal: type, satellite, high and low bits of the range, Doppler, C/N0, information, and
# number of further signals.
FIRST = Struct("<xBBBIi3xB2xBB")
# Further signal: type, C/N0, high bits of the differences, information, low bits.
FURTHER = Struct("<BxBBxBH2xH")
SCRAMBLED = 0x80  # flag: ranges are scrambled, as the receiver lacks the permission
STEP_M, STEP_HZ, STEP_DB, LEAST_DB = 1e-3, 1e-4, 0.25, 10.0
NO_DOPPLER, NO_CN0 = -(2**31), 255
NO_RANGE_STEPS, NO_RATE_STEPS = -4 << 16, -16 << 16  # of a further signal
MORE_SIGNALS = 31  # value of the five signal bits if the number, 32 or more, is in the information
CHANNEL_ZERO = 8  # offset of GLONASS channel numbers in the information
SIGNALS = {  # by signal number: RINEX system letter and signal code
    0: "G1C", 1: "G1W", 2: "G2W", 3: "G2L", 4: "G5Q", 5: "G1L", 6: "J1C", 7: "J2L", 8: "R1C",
    9: "R1P", 10: "R2P", 11: "R2C", 13: "C1P", 14: "C5P", 17: "E1C", 19: "E6C", 20: "E5Q",
    21: "E7Q", 22: "E8Q", 26: "J5Q", 28: "C2I", 29: "C7I", 30: "C6I", 32: "J1L", 34: "C7D",
    38: "J1E",
}  # fmt: skip
CARRIERS_HZ = {number: carrier_of(name[0], name[1:]) for number, name in SIGNALS.items()}
FIRST_SIGNALS = ("1C", "1E", "2I")  # whose ranges are used, beside those of a second frequency


def read_sbf(path: Path) -> tuple[list[Epoch], list[EphemerisSample | IonosphereSample]]:
    """All epochs of a log; and its ephemerides and Klobuchar coefficients, with timestamp 0.

    Raises
    ------
    ConfigError
        If the log cannot be read or holds no MeasEpoch.
    """
    blocks = list(_blocks(read_log_bytes(path, "a Septentrio log")))
    measured = [block[OVERHEAD_BYTES:] for block in blocks if block_number(block) == MEAS_EPOCH]
    if not measured:
        raise ConfigError(
            f"{path}: has no complete MeasEpoch; enable it in the receiver (not Meas3Ranges),"
            " and GPSNav, GALNav, GLONav, BDSNav, QZSNav and GPSIon"
        )
    epochs = list(_epochs(measured))
    near_s = epochs[0].t_us * 1e-6 if epochs else 0.0
    # A receiver repeats its blocks under later stamps.
    sent = {block[4:8] + block[14:]: block for block in blocks if block_number(block) in ORBITS}
    found = (read_orbit(block, near_s) for block in sent.values())
    return epochs, [sample for sample in found if sample is not None]


def _blocks(data: bytes) -> Iterator[bytes]:
    """Each complete block of a supported type."""
    at = data.find(SYNC)
    while at >= 0:
        head = data[at : at + OVERHEAD_BYTES]
        summed, length = (int.from_bytes(head[k : k + 2], "little") for k in (2, 6))
        number, block = block_number(head), data[at : at + length]
        # A false start or a corrupted length must not hide the blocks after it.
        supported = number == MEAS_EPOCH or number in ORBITS
        if supported and len(block) == length >= OVERHEAD_BYTES and crc_hqx(block[4:], 0) == summed:
            yield block
            at += length - 1
        at = data.find(SYNC, at + 1)


def _epochs(payloads: list[bytes]) -> Iterator[Epoch]:
    """The epochs; one epoch may span several consecutive blocks."""
    usable = (payload for payload in payloads if len(payload) >= HEAD.size)
    for (tow_ms, week), together in groupby(usable, lambda payload: HEAD.unpack_from(payload)[:2]):
        rows: tuple[dict[str, CodeObservation], ...] = {}, {}
        channels: dict[str, int] = {}
        for tracked in (found for payload in together for found in _tracked(payload)):
            name, known = satellite_name(tracked.satellite), SIGNALS.get(tracked.signal, " ")
            if name is None or name[0] != known[0] or not tracked.usable:
                continue
            second, signal = known[1:] in SECOND[known[0]], known[1:]
            if second or signal in FIRST_SIGNALS:
                values = tracked.range_m, tracked.doppler_hz, tracked.cn0_dbhz
                row = name, values, CARRIERS_HZ[tracked.signal], signal
                rows[second].setdefault(name, row)
            if known == "R1C":
                channels[name] = (tracked.information >> 3) - CHANNEL_ZERO
        epoch = epoch_of(week, 1e-3 * tow_ms, rows[0].values(), channels, rows[1])
        if epoch is not None and tow_ms < 1000 * WEEK_S:
            yield epoch


class TrackedSignal(NamedTuple):
    """One tracked signal of a satellite; unknown values are NaN."""

    satellite: int
    kind: int
    information: int
    range_m: float
    doppler_hz: float
    cn0: int

    @property
    def signal(self) -> int:
        """Septentrio's signal number."""
        low = self.kind & MORE_SIGNALS
        return low if low < MORE_SIGNALS else MORE_SIGNALS + 1 + (self.information >> 3)

    @property
    def usable(self) -> bool:
        """Whether it has a range and was received by the main antenna."""
        return self.kind >> 5 == 0 and self.range_m > 0.0

    @property
    def cn0_dbhz(self) -> float:
        """C/N0 of a signal without encryption."""
        return LEAST_DB + STEP_DB * self.cn0 if self.cn0 != NO_CN0 else math.nan


def _tracked(payload: bytes) -> Iterator[TrackedSignal]:
    """All signals of a block; stops where the block is truncated."""
    _tow_ms, _week, count, first_size, further_size, flags = HEAD.unpack_from(payload)
    at = HEAD.size
    for _ in range(0 if flags & SCRAMBLED else count):
        if at + max(first_size, FIRST.size) > len(payload):
            return
        kind, satellite, high, low, doppler, cn0, information, others = FIRST.unpack_from(
            payload, at
        )
        at += max(first_size, FIRST.size)
        doppler_hz = STEP_HZ * doppler if doppler != NO_DOPPLER else math.nan
        range_m = STEP_M * ((high & 15) << 32 | low)
        first = TrackedSignal(satellite, kind, information, range_m, doppler_hz, cn0)
        yield first
        for _ in range(others):
            if at + max(further_size, FURTHER.size) > len(payload):
                return
            yield _further(first, *FURTHER.unpack_from(payload, at))
            at += max(further_size, FURTHER.size)


def _further(
    first: TrackedSignal, kind: int, cn0: int, high: int, information: int, low: int, rate: int
) -> TrackedSignal:
    """Decode a further signal from its differences to the first; a missing range is NaN."""
    range_steps = ((high & 7 ^ 4) - 4) << 16 | low
    rate_steps = ((high >> 3 ^ 16) - 16) << 16 | rate
    range_m = first.range_m + STEP_M * range_steps
    found = TrackedSignal(first.satellite, kind, information, range_m, math.nan, cn0)
    carriers_hz = CARRIERS_HZ.get(found.signal), CARRIERS_HZ.get(first.signal)
    if not first.range_m > 0.0 or range_steps == NO_RANGE_STEPS:
        return found._replace(range_m=math.nan)
    if carriers_hz[0] is None or carriers_hz[1] is None or rate_steps == NO_RATE_STEPS:
        return found
    ratio = carriers_hz[0] / carriers_hz[1]
    return found._replace(doppler_hz=ratio * first.doppler_hz + STEP_HZ * rate_steps)
