"""Compiled reader of the pseudoranges of many MSM7 messages, for the monitor.

It gives the same values as `msm7.decode_msm7`. Importing this imports numba.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import compiled, constant
from mavproxy_fault.rtcm.msm7 import (
    CN0_STEP_DBHZ,
    FINE_INVALID,
    FINE_PER_ROUGH,
    FINE_RATE_INVALID,
    MS_M,
    NUMBERS,
    RATE_INVALID,
    ROUGH,
    ROUGH_INVALID,
)
from mavproxy_fault.rtcm.transport import HEADER, TRAILER
from mavproxy_fault.rtcm.tunnel_columns import Messages

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]

MASK_BIT, SIGNAL_BIT, CELL_BIT = 73, 137, 169  # masks of satellites, signals and cells
SATELLITE_BITS, SIGNAL_BITS = 36, 80
LEAST_BYTES = 14  # size of one satellite with one signal
# Widths in bits
FLAG, MS, ROUGH_PART, CN0, NUMBER, RATE, HALF_EPOCH, FINE_RATE, FINE = (
    constant(bits) for bits in (1, 8, 10, 10, 12, 14, 15, 15, 20)
)
NO_MSM7, NO_ROWS = -1, constant(0)
NUMBERS_OF_SATELLITES = 65
NAMES = tuple(f"{letter}{n:02d}" for letter in NUMBERS for n in range(NUMBERS_OF_SATELLITES))
_SYSTEM_NUMBERS = np.array(list(NUMBERS.values()))


class RangeColumns(NamedTuple):
    """Observations of k messages: of each satellite, the first signal with a pseudorange.

    Per message: `tow_ms` (k,), NO_MSM7 if it is not of GPS or Galileo or is truncated; `more` (k,),
    whether another message of the same epoch follows; `ends` (k,), the end of its rows. Per row:
    `code` (n,), the satellite's index in NAMES, and the observations (n,); NaN means "not given".
    """

    tow_ms: Integers
    more: Integers
    ends: Integers
    code: Integers
    pseudorange_m: Floats
    doppler_mps: Floats
    cn0_dbhz: Floats


def read_ranges(messages: Messages) -> RangeColumns:
    """Read all MSM7 messages among RTCM messages."""
    heads = np.empty((3, len(messages.ends)), np.int64)
    # Upper bound of the number of rows, so that no array grows in the loop.
    capacity = len(messages.data) // LEAST_BYTES
    code, values = np.empty(capacity, np.int64), np.empty((3, capacity))
    count = _read(messages.data, messages.ends, _SYSTEM_NUMBERS, heads, code, values)
    tow_ms, more, ends = heads
    pseudorange_m, doppler_mps, cn0_dbhz = values[:, :count]
    return RangeColumns(tow_ms, more, ends, code[:count], pseudorange_m, doppler_mps, cn0_dbhz)


@compiled
def _read(
    data: Bytes,
    ends: Integers,
    numbers: Integers,
    heads: Integers,
    code: Integers,
    values: Floats,
) -> int:
    """Fill the columns of `RangeColumns`; return the number of rows."""
    rows, begin = NO_ROWS, 0
    for message in range(len(ends)):
        at, end = 8 * (begin + HEADER), 8 * (ends[message] - TRAILER)
        begin = ends[message]
        heads[0, message], heads[1, message] = NO_MSM7, 0
        system = -1
        for i in range(len(numbers)):
            if end - at >= CELL_BIT and _bits(data, at, NUMBER) == numbers[i]:
                system = i
        if system >= 0 and _is_complete(data, at, end):
            # Thirty bits of milliseconds in two halves, since `_bits` reads at most 25.
            heads[0, message] = _bits(data, at + 24, HALF_EPOCH) << 15
            heads[0, message] |= _bits(data, at + 39, HALF_EPOCH)
            heads[1, message] = _bits(data, at + 54, FLAG)
            rows = _append_rows(data, at, NUMBERS_OF_SATELLITES * system, code, values, rows)
        heads[2, message] = rows
    return rows


@compiled
def _bits(data: Bytes, at: int, width: int) -> int:
    """Read an unsigned number of up to 25 bits; the trailer after it may be read too."""
    byte = at >> 3
    word = np.int64(data[byte]) << 24 | np.int64(data[byte + 1]) << 16
    word |= np.int64(data[byte + 2]) << 8 | np.int64(data[byte + 3])
    return int((word >> (32 - (at & 7) - width)) & ((1 << width) - 1))


@compiled
def _signed(data: Bytes, at: int, width: int) -> int:
    """Read a signed number of up to 25 bits."""
    value = _bits(data, at, width)
    return value - (1 << width) if value >> (width - 1) else value


@compiled
def _count(data: Bytes, at: int, width: int) -> int:
    """Count the bits that are set."""
    total = 0
    for bit in range(at, at + width):
        total += data[bit >> 3] >> (7 - (bit & 7)) & 1
    return total


@compiled
def _is_complete(data: Bytes, at: int, end: int) -> bool:
    """Whether a message has room for all satellites and signals of its masks."""
    count = _count(data, at + MASK_BIT, SIGNAL_BIT - MASK_BIT)
    cells = count * _count(data, at + SIGNAL_BIT, CELL_BIT - SIGNAL_BIT)
    begin = at + CELL_BIT + cells
    # The masks may claim cells beyond the end of the message.
    if begin > end:
        return False
    total = _count(data, at + CELL_BIT, cells)
    return begin + SATELLITE_BITS * count + SIGNAL_BITS * total <= end


@compiled
def _append_rows(
    data: Bytes, at: int, first: int, code: Integers, values: Floats, rows: int
) -> int:
    """Append the satellites of a message with a pseudorange; return the number of rows."""
    count = _count(data, at + MASK_BIT, SIGNAL_BIT - MASK_BIT)
    signals = _count(data, at + SIGNAL_BIT, CELL_BIT - SIGNAL_BIT)
    rough_at = at + CELL_BIT + count * signals
    total = _count(data, at + CELL_BIT, count * signals)
    fine_at = rough_at + SATELLITE_BITS * count
    satellite = cell = 0
    # The satellite mask has 64 bits, the first for number 1.
    for n in range(64):
        if not _bits(data, at + MASK_BIT + n, FLAG):
            continue
        rough_ms = _bits(data, rough_at + MS * satellite, MS)
        # Without a rough range the fine part is meaningless.
        taken = rough_ms == ROUGH_INVALID
        for s in range(signals):
            if not _bits(data, at + CELL_BIT + satellite * signals + s, FLAG):
                continue
            fine = _signed(data, fine_at + FINE * cell, FINE)
            if not taken and fine != FINE_INVALID:
                taken = True
                # Fields are sent column by column.
                part_at = rough_at + 12 * count + ROUGH_PART * satellite
                rough = ROUGH * rough_ms + _bits(data, part_at, ROUGH_PART)
                rate = _signed(data, rough_at + 22 * count + RATE * satellite, RATE)
                fine_rate = _signed(data, fine_at + 65 * total + FINE_RATE * cell, FINE_RATE)
                cn0 = _bits(data, fine_at + 55 * total + CN0 * cell, CN0)
                known = rate != RATE_INVALID and fine_rate != FINE_RATE_INVALID
                counts = rough * FINE_PER_ROUGH + fine
                code[rows] = first + n + 1
                values[0, rows] = counts / (ROUGH * FINE_PER_ROUGH) * MS_M
                values[1, rows] = rate + fine_rate / 10_000 if known else np.nan
                # 0 means "not given".
                values[2, rows] = cn0 * CN0_STEP_DBHZ if cn0 else np.nan
                rows += 1
            cell += 1
        satellite += 1
    return rows
