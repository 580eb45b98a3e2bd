"""Many datagrams per call, with `sendmmsg(2)` and `recvmmsg(2)` of 64-bit Linux.

A test's own sender and reader in Python must not be what is short of processor time. Other than
the proxy's these calls give up the interpreter's lock, as here threads share it.
"""

import ctypes
import socket
import struct
from collections.abc import Sequence

import numpy as np

ROOM = 512  # for datagrams that wait
ROW = 512  # maximum bytes of a received datagram
CONTROL = 64  # bytes for what the kernel says about it
STAMP = slice(16, 32)  # of those: seconds and nanoseconds, after a header of 16 bytes
_PART = np.dtype([("base", "u8"), ("length", "u8")])
_MESSAGE = np.dtype(
    [("name", "u8"), ("name_length", "u8"), ("part", "u8"), ("part_count", "u8"),
     ("control", "u8"), ("control_length", "u8"), ("flags", "u8"), ("length", "u4"), ("_", "u4")]
)  # fmt: skip
_LIBC = ctypes.CDLL(None, use_errno=True)


def _messages(parts: np.ndarray) -> np.ndarray:
    """Headers of one datagram for each part."""
    messages = np.zeros(len(parts), _MESSAGE)
    messages["part"] = parts.ctypes.data + _PART.itemsize * np.arange(len(parts))
    messages["part_count"] = 1
    return messages


def send_all(sock: socket.socket, datagrams: Sequence[bytes]) -> int:
    """Send datagrams to where a socket is connected; how many the kernel took."""
    lengths = np.fromiter(map(len, datagrams), np.uint64, len(datagrams))
    data = np.frombuffer(b"".join(datagrams), np.uint8)
    parts = np.zeros(len(datagrams), _PART)
    parts["length"] = lengths
    parts["base"] = data.ctypes.data + np.cumsum(lengths) - lengths
    messages = _messages(parts)
    address = ctypes.c_void_p(messages.ctypes.data)
    return max(int(_LIBC.sendmmsg(sock.fileno(), address, len(datagrams), 0)), 0)


class Inbox:
    """Reads all that waits at a socket with SO_TIMESTAMPNS, 512 datagrams at a time."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._data = np.zeros((ROOM, ROW), np.uint8)
        self._control = np.zeros((ROOM, CONTROL), np.uint8)
        self._parts = np.zeros(ROOM, _PART)
        self._parts["base"] = self._data.ctypes.data + ROW * np.arange(ROOM)
        self._parts["length"] = ROW
        self._messages = _messages(self._parts)
        self._messages["control"] = self._control.ctypes.data + CONTROL * np.arange(ROOM)

    def receive(self) -> np.ndarray:
        """The datagrams that wait, one in a row; none where nothing does."""
        self._messages["control_length"] = CONTROL
        address = ctypes.c_void_p(self._messages.ctypes.data)
        flags = socket.MSG_DONTWAIT
        count = int(_LIBC.recvmmsg(self._sock.fileno(), address, ROOM, flags, None))
        return self._data[: max(count, 0)]

    def came_s(self, row: int) -> float:
        """When the kernel got the datagram of a row."""
        seconds, nanoseconds = struct.unpack("qq", self._control[row, STAMP])
        return float(seconds + 1e-9 * nanoseconds)
