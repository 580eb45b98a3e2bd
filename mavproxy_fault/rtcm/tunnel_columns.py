"""Reassembly of RTCM messages from many TUNNEL payloads of any number of senders."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.rtcm.transport import HEADER, TRAILER, Reassembler

Integers = NDArray[np.int64]
Bytes = NDArray[np.uint8]

SENDERS_MAX = 16  # further senders share a place; mixed fragments fail the CRC


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
        self._places: dict[int, Reassembler] = {}
        self._reassemblers = [Reassembler() for _ in range(SENDERS_MAX)]

    def add(self, sender: Integers, payload: Bytes, length: Integers) -> Messages:
        """Add payloads (m, 128) of `length` (m,); return the messages that they complete.

        `sender` (m,) is the number of the sender of each.
        """
        known, data, ends, rows = self._places, bytearray(), list[int](), list[int]()
        for row, (number, size) in enumerate(zip(sender.tolist(), length.tolist(), strict=True)):
            # Senders are assigned to places in order of appearance, cyclically.
            place = known.setdefault(number, self._reassemblers[len(known) % SENDERS_MAX])
            if 0 < size <= payload.shape[1]:
                for message in place.add(payload[row, :size].tobytes()):
                    data += message
                    ends.append(len(data))
                    rows.append(row)
        found = np.array(ends, np.int64), np.array(rows, np.int64)
        return Messages(np.frombuffer(data, np.uint8), *found)
