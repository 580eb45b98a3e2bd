"""The pseudoranges of an MSM7 message as arrays, read by compiled code: what a monitor wants of it.

The same values as `msm7.decode_msm7` gives, twenty times faster. Importing this imports numba.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.wire.compiled import exact
from mavproxy_fault.wire.msm7 import (
    CN0_STEP_DBHZ,
    FINE_INVALID,
    FINE_PER_ROUGH,
    FINE_RATE_INVALID,
    MS_M,
    RATE_INVALID,
    ROUGH,
    ROUGH_INVALID,
    SYSTEMS,
)
from mavproxy_fault.wire.rtcm import CRC24Q_TABLE, HEADER, TRAILER

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
Bits = NDArray[np.uint8]

HEAD_BITS = 73 + 64 + 32  # up to the mask of cells
WIDTHS = np.array([8, 10, -14, -20, -15, 10])  # rough range, rate, fine range and rate, C/N0
_NAMES = {letter: tuple(f"{letter}{n:02d}" for n in range(65)) for letter in SYSTEMS.values()}


_CRC_TABLE = np.array(CRC24Q_TABLE)


class Ranges(NamedTuple):
    """One epoch of one system: parallel (n,); NaN stands for what is not given.

    `more` says that another message of the same epoch follows.
    """

    tow_s: float
    satellites: tuple[str, ...]
    pseudorange_m: Floats
    doppler_mps: Floats
    cn0_dbhz: Floats
    more: bool


def read_ranges(message: bytes) -> Ranges:
    """One signal per satellite, the first in the order of the signal mask that has a pseudorange.

    Raises
    ------
    ValueError
        If it is no MSM7 message of GPS or Galileo, or ends early. Its CRC is not looked at: the
        messages of a `Reassembler` have been checked.
    """
    head = int.from_bytes(message[HEADER : HEADER + 7], "big")  # number, station, epoch, more
    number, epoch_ms, more = head >> 44, head >> 2 & 0x3FFFFFFF, head >> 1 & 1
    system = SYSTEMS.get(number)
    bits = np.unpackbits(np.frombuffer(message, np.uint8)[HEADER:-TRAILER])
    satellites = np.flatnonzero(bits[73:137]) + 1
    count, signals = len(satellites), int(bits[137:HEAD_BITS].sum())
    begin = HEAD_BITS + count * signals  # of what is said of satellites
    given = bits[HEAD_BITS:begin]
    total = int(given.sum())
    fine = begin + 36 * count  # of what is said of signals
    if system is None or len(bits) < max(HEAD_BITS, fine + 80 * total):
        raise ValueError(f"RTCM {number} is not a whole MSM7 of GPS or Galileo (1077, 1097)")
    satellite_bits = (begin, begin + 12 * count, begin + 22 * count)
    begins = (*satellite_bits, fine, fine + 65 * total, fine + 55 * total)
    columns = np.zeros((6, max(count, total)), np.int64)
    _fields(bits, np.array(begins), WIDTHS, np.array([count] * 3 + [total] * 3), columns)
    values, which = np.empty((3, count)), np.empty(count, np.int64)
    usable = _values(columns, given, signals, values, which)
    names = _NAMES[system]
    return Ranges(
        epoch_ms / 1000.0,
        tuple([names[n] for n in satellites[which[:usable]].tolist()]),
        values[0, :usable],
        values[1, :usable],
        values[2, :usable],
        bool(more),
    )


def quick_crc24q(data: bytes) -> int:
    """As `rtcm.crc24q`, for messages by the thousand."""
    return _crc24q(np.frombuffer(data, np.uint8), _CRC_TABLE)


@exact
def _crc24q(data: NDArray[np.uint8], table: Integers) -> int:
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFFFF) ^ table[crc >> 16 ^ byte]
    return crc


@exact
def _fields(
    bits: Bits, begins: Integers, widths: Integers, counts: Integers, out: Integers
) -> None:
    """Columns (c, n) of numbers: so many of a width from a bit on; a negative width is signed."""
    for column in range(len(begins)):
        at = begins[column]
        for i in range(counts[column]):
            value = np.int64(0)
            for bit in range(at, at + abs(widths[column])):
                value = 2 * value + bits[bit]
            at += abs(widths[column])
            if widths[column] < 0 and value >> (-widths[column] - 1):
                value -= 1 << -widths[column]
            out[column, i] = value


@exact
def _values(columns: Integers, given: Bits, signals: int, out: Floats, which: Integers) -> int:
    """Range, rate and C/N0 (3, n) of the satellites that have them, which these are, how many.

    `columns` are rough range in ms and the rest, rate, fine range, fine rate and C/N0; `given`
    (satellites * signals,) tells which signals there are.
    """
    usable = cell = 0
    for satellite in range(len(which)):
        taken = columns[0, satellite] == ROUGH_INVALID
        for s in range(signals):
            if not given[satellite * signals + s]:
                continue
            if not taken and columns[3, cell] != FINE_INVALID:
                taken = True
                rough = columns[0, satellite] * ROUGH + columns[1, satellite]
                counts = rough * FINE_PER_ROUGH + columns[3, cell]
                rate, fine_rate, cn0 = columns[2, satellite], columns[4, cell], columns[5, cell]
                known = rate != RATE_INVALID and fine_rate != FINE_RATE_INVALID
                out[0, usable] = counts / (ROUGH * FINE_PER_ROUGH) * MS_M
                out[1, usable] = rate + fine_rate / 10_000 if known else np.nan
                out[2, usable] = cn0 * CN0_STEP_DBHZ if cn0 else np.nan
                which[usable] = satellite
                usable += 1
            cell += 1
    return usable
