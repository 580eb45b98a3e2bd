"""Compiled reassembly of RTCM messages from many TUNNEL payloads, as `transport.Reassembler`.

Importing this imports numba.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import compiled, constant
from mavproxy_fault.rtcm.transport import (
    CRC24Q_TABLE,
    FRAGMENT_BYTES,
    FRAGMENTS_MAX,
    HEADER,
    MESSAGE_MAX,
    PENDING_MAX,
    PREAMBLE,
    TRAILER,
)

Integers = NDArray[np.int64]
Bytes = NDArray[np.uint8]

SENDERS_MAX = 16  # further senders share their slots; mixed fragments fail the CRC
SLOTS = PENDING_MAX + 1  # slots for incomplete messages; the oldest is dropped when all are used
AGE, SEQUENCE, LENGTHS = 0, 1, 2  # columns of an incomplete message; age 0: free slot
SHORTEST = HEADER + TRAILER
ZERO = constant(0)
_CRC_TABLE = np.array(CRC24Q_TABLE)


class Messages(NamedTuple):
    """Complete RTCM messages with valid CRC: message i is `data[ends[i - 1] : ends[i]]`.

    `row` (k,) is the payload that completed each.
    """

    data: Bytes
    ends: Integers
    row: Integers

    @property
    def number(self) -> Integers:
        """The RTCM number of each message (k,); 0 if its body is too short."""
        begins = np.concatenate([np.zeros(1, np.int64), self.ends])[:-1]
        high, low = self.data[begins + HEADER].astype(np.int64), self.data[begins + HEADER + 1]
        return np.where(self.ends - begins >= HEADER + 2 + TRAILER, high << 4 | low >> 4, 0)

    def bytes(self, number: int) -> bytes:
        """Return one message."""
        begin = int(self.ends[number - 1]) if number else 0
        return self.data[begin : int(self.ends[number])].tobytes()


class Assembler:
    """Reassembles the fragments of any number of senders."""

    def __init__(self) -> None:
        self._slots: dict[int, int] = {}
        self._pending = np.zeros((SENDERS_MAX, SLOTS, LENGTHS + FRAGMENTS_MAX), np.int64)
        self._stored = np.zeros((SENDERS_MAX, SLOTS, FRAGMENTS_MAX, FRAGMENT_BYTES), np.uint8)

    def add(self, sender: Integers, payload: Bytes, length: Integers) -> Messages:
        """Add payloads (m, 128) of `length` (m,); return the messages that they complete.

        `sender` (m,) is the number of the sender of each.
        """
        known = self._slots
        # Senders are assigned to slots in order of appearance, cyclically.
        slot = [known.setdefault(n, len(known) % SENDERS_MAX) for n in sender.tolist()]
        # Upper bound: the new and the stored bytes.
        capacity = payload.size + self._stored.size
        data = np.empty(capacity, np.uint8)
        found = np.empty((capacity // SHORTEST + 1, 2), np.int64)
        count = _assemble(
            payload, length, np.array(slot, np.int64), self._pending, self._stored,
            data, found, _CRC_TABLE,
        )  # fmt: skip
        ends, row = found[:count].T.copy()
        return Messages(data[: ends[-1] if count else 0], ends, row)


@compiled
def _assemble(
    payload: Bytes,
    length: Integers,
    slot: Integers,
    pending: Integers,
    stored: Bytes,
    data: Bytes,
    found: Integers,
    table: Integers,
) -> int:
    """Fill `data`, and end and row of each message in `found`; return their number."""
    count = ZERO
    message = np.empty(MESSAGE_MAX, np.uint8)
    for row in range(len(length)):
        if length[row] < 1 or length[row] > payload.shape[1]:
            continue
        flags, slots, parts = payload[row, 0], pending[slot[row]], stored[slot[row]]
        at = _find_slot(slots, flags >> 3, flags & 1)
        # The first byte is the flags.
        size = length[row] - 1
        if flags & 1:
            slots[at, LENGTHS + (flags >> 1 & 3)] = size
            for i in range(size):
                parts[at, flags >> 1 & 3, i] = payload[row, 1 + i]
            size = _join(slots[at], parts[at], message)
            if size < 0:
                _drop_oldest(slots)
                continue
        else:
            for i in range(size):
                message[i] = payload[row, 1 + i]
        # Complete, or superseded by an unfragmented message with the same number.
        if at >= 0:
            slots[at, AGE] = 0
        count = _append_messages(message, size, row, data, found, count, table)
    return count


@compiled
def _find_slot(slots: Integers, sequence: int, begin: int) -> int:
    """Return the slot of a sequence number, if necessary a new one; -1 if it does not exist and
    none is to `begin`."""
    free, newest = -1, 0
    for at in range(SLOTS):
        newest = max(newest, slots[at, AGE])
        if slots[at, AGE] == 0:
            free = at
        elif slots[at, SEQUENCE] == sequence:
            return at
    if not begin:
        return -1
    # Ages only grow, so the smallest one is the oldest.
    slots[free, AGE], slots[free, SEQUENCE] = newest + 1, sequence
    for number in range(FRAGMENTS_MAX):
        slots[free, LENGTHS + number] = -1
    return free


@compiled
def _join(lengths: Integers, parts: Bytes, message: Bytes) -> int:
    """Join fragments up to the first that is not full; return the length, -1 if one is missing."""
    size = 0
    for number in range(FRAGMENTS_MAX):
        length = lengths[LENGTHS + number]
        if length < 0:
            return -1
        for i in range(length):
            message[size + i] = parts[number, i]
        size += length
        if length < FRAGMENT_BYTES:
            break
    return size


@compiled
def _drop_oldest(slots: Integers) -> None:
    """Free the slot of the oldest message if none is free."""
    oldest = 0
    for at in range(SLOTS):
        if slots[at, AGE] < slots[oldest, AGE]:
            oldest = at
    slots[oldest, AGE] = 0


@compiled
def _append_messages(
    message: Bytes,
    size: int,
    row: int,
    data: Bytes,
    found: Integers,
    count: int,
    table: Integers,
) -> int:
    """Append the messages with valid CRC in `whole`; return their number."""
    at = ZERO
    while at <= size - SHORTEST:
        body = (message[at + 1] & 3) << 8 | message[at + 2]
        end = at + SHORTEST + body
        if message[at] != PREAMBLE or end > size or _crc(message, at, end, table):
            # The next preamble may lie inside.
            at += 1
            continue
        # Messages are stored consecutively.
        begin = found[count - 1, 0] if count else 0
        for i in range(end - at):
            data[begin + i] = message[at + i]
        found[count, 0], found[count, 1] = begin + end - at, row
        count += 1
        at = end
    return count


@compiled
def _crc(data: Bytes, begin: int, end: int, table: Integers) -> int:
    """Compute the CRC-24Q of a range of bytes; 0 for a message that ends with its CRC."""
    crc = 0
    for i in range(begin, end):
        crc = (crc << 8 & 0xFFFFFF) ^ table[crc >> 16 ^ data[i]]
    return crc
