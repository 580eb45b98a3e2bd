"""Datagrams in batches, without giving up the interpreter's lock.

Python's sockets release the lock around every call; where another thread computes (the compiled
path being loaded, a bus callback), getting it back costs up to a whole turn of that thread, per
datagram. These calls never block, so they can keep the lock: one call receives up to 64 datagrams.
The structures are those of 64-bit Linux (`recvmmsg(2)`); where that call is missing, as on macOS,
datagrams are received one by one, and the compiled form stays away.
"""

import ctypes
import socket
from typing import Protocol

BATCH = 64
# The longest datagram: a shorter buffer would cut one without a word.
ROW = 65_536
NAME = 32  # bytes kept for a socket address
DONTWAIT = socket.MSG_DONTWAIT

_LIBC = ctypes.PyDLL(None)  # unlike CDLL it keeps the lock
BATCHES = hasattr(_LIBC, "recvmmsg")
if BATCHES:
    _LIBC.recvmmsg.argtypes = [
        ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p,
    ]  # fmt: skip
_LIBC.recvfrom.argtypes = [
    ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p,
]  # fmt: skip
_LIBC.recvfrom.restype = ctypes.c_ssize_t
_LIBC.sendto.argtypes = [
    ctypes.c_int, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint,
]  # fmt: skip
_LIBC.sendto.restype = ctypes.c_ssize_t


class _Part(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _Message(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint),
        ("part", ctypes.c_void_p),
        ("part_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
        ("padding", ctypes.c_int),  # `struct msghdr` ends at a multiple of eight bytes
        ("length", ctypes.c_uint),
    )


class Receiver(Protocol):
    """One socket's incoming side."""

    def receive(self) -> list[tuple[bytes, bytes]]:
        """The raw addresses and bytes of datagrams that wait, at most 64."""
        ...


def receiver(fileno: int) -> Receiver:
    """The receiver that this system has the calls for."""
    return BatchReceiver(fileno) if BATCHES else SingleReceiver(fileno)


class SingleReceiver:
    """Buffers for one datagram."""

    def __init__(self, fileno: int) -> None:
        self._fileno = fileno
        self._data, self._name = ctypes.create_string_buffer(ROW), ctypes.create_string_buffer(NAME)
        self._view = memoryview(self._data)

    def receive(self) -> list[tuple[bytes, bytes]]:
        """The raw addresses and bytes of datagrams that wait, at most 64."""
        found: list[tuple[bytes, bytes]] = []
        while len(found) < BATCH:
            name_length = ctypes.c_uint(NAME)
            length = _LIBC.recvfrom(
                self._fileno, self._data, ROW, DONTWAIT, self._name, ctypes.byref(name_length)
            )
            if length < 0:
                break
            found.append((self._name.raw[: name_length.value], bytes(self._view[:length])))
        return found


class BatchReceiver:
    """Buffers for 64 datagrams."""

    def __init__(self, fileno: int) -> None:
        self._fileno = fileno
        self._data = ctypes.create_string_buffer(BATCH * ROW)
        self._names = ctypes.create_string_buffer(BATCH * NAME)
        self._parts = (_Part * BATCH)()
        self._messages = (_Message * BATCH)()
        self._view = memoryview(self._data)
        self._name_view = memoryview(self._names)
        for n, (part, message) in enumerate(zip(self._parts, self._messages, strict=True)):
            part.base, part.length = ctypes.addressof(self._data) + n * ROW, ROW
            message.name = ctypes.addressof(self._names) + n * NAME
            message.name_length = NAME
            message.part, message.part_count = ctypes.addressof(part), 1

    def receive(self) -> list[tuple[bytes, bytes]]:
        """The raw addresses and bytes of datagrams that wait, at most 64."""
        count = _LIBC.recvmmsg(self._fileno, self._messages, BATCH, DONTWAIT, None)
        found = []
        # The count is -1 where nothing waits: then there is nothing to go through.
        for n in range(count):
            message = self._messages[n]
            name = bytes(self._name_view[n * NAME : n * NAME + message.name_length])
            # Copied, as the buffers are filled again at the next call.
            found.append((name, bytes(self._view[n * ROW : n * ROW + message.length])))
            message.name_length = NAME
        return found


def send(fileno: int, data: bytes, name: bytes | None = None) -> bool:
    """Send one datagram; False if the kernel did not take it."""
    length = 0 if name is None else len(name)
    return bool(_LIBC.sendto(fileno, data, len(data), DONTWAIT, name, length) >= 0)
