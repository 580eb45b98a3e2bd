"""Datagrams received in batches, without releasing the interpreter lock (GIL).

Python's sockets release the lock around every call. While another thread computes (loading the
compiled path, a bus callback), regaining it takes up to a full switch interval per datagram. These
calls never block, so they keep the lock; one call receives up to 64 datagrams. The structures are
those of 64-bit Linux (`recvmmsg(2)`); on systems without that call, such as macOS and Windows,
`datagram_plain` is used and the compiled path is unavailable.
"""

import ctypes
import socket
from typing import Any

BATCH = 64
# The longest datagram: a shorter buffer would truncate silently.
MAX_DATAGRAM = 65_536
ADDRESS_SIZE = 32  # bytes reserved for a socket address
DONTWAIT = getattr(socket, "MSG_DONTWAIT", 0)  # Windows has none


def _libc() -> Any:
    """Load the C library; None if it lacks the calls needed."""
    try:
        libc = ctypes.PyDLL(None)  # unlike CDLL it does not release the lock
    except TypeError:  # Windows cannot open the process itself
        return None
    if not hasattr(libc, "recvmmsg"):
        return None
    libc.recvmmsg.argtypes = [
        ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p,
    ]  # fmt: skip
    libc.sendto.argtypes = [
        ctypes.c_int, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_char_p,
        ctypes.c_uint,
    ]  # fmt: skip
    libc.sendto.restype = ctypes.c_ssize_t
    return libc


_LIBC = _libc()
HAS_RECVMMSG = _LIBC is not None


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


class BatchedDatagrams:
    """One socket, and buffers for 64 datagrams."""

    def __init__(self, sock: socket.socket) -> None:
        self._fileno = sock.fileno()
        self._data = ctypes.create_string_buffer(BATCH * MAX_DATAGRAM)
        self._names = ctypes.create_string_buffer(BATCH * ADDRESS_SIZE)
        self._parts = (_Part * BATCH)()
        self._messages = (_Message * BATCH)()
        self._view = memoryview(self._data)
        self._name_view = memoryview(self._names)
        for n, (part, message) in enumerate(zip(self._parts, self._messages, strict=True)):
            part.base, part.length = ctypes.addressof(self._data) + n * MAX_DATAGRAM, MAX_DATAGRAM
            message.name = ctypes.addressof(self._names) + n * ADDRESS_SIZE
            message.name_length = ADDRESS_SIZE
            message.part, message.part_count = ctypes.addressof(part), 1

    def receive(self) -> list[tuple[bytes, bytes]]:
        """Return raw address and bytes of waiting datagrams, at most 64."""
        count = _LIBC.recvmmsg(self._fileno, self._messages, BATCH, DONTWAIT, None)
        datagrams = []
        # The count is -1 if no datagram waits.
        for n in range(count):
            message = self._messages[n]
            name = bytes(self._name_view[n * ADDRESS_SIZE : n * ADDRESS_SIZE + message.name_length])
            # Copied, because the next call reuses the buffers.
            datagrams.append(
                (name, bytes(self._view[n * MAX_DATAGRAM : n * MAX_DATAGRAM + message.length]))
            )
            message.name_length = ADDRESS_SIZE
        return datagrams

    def send(self, data: bytes, address: bytes | None = None) -> bool:
        """Send one datagram; return False if the kernel did not accept it."""
        length = 0 if address is None else len(address)
        sent = _LIBC.sendto(self._fileno, data, len(data), DONTWAIT, address, length)
        return bool(sent >= 0)
