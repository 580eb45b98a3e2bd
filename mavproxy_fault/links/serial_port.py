"""Serial devices: non-blocking, with a bounded queue, opened again after they were unplugged."""

import contextlib
import os
import select
import time

import serial

from mavproxy_fault.links.link import Chunk, LinkCounters
from mavproxy_fault.links.stream import Stream

REOPEN_S = 0.5


class SerialPort:
    """One device; `fileno` is an epoll descriptor that outlives unplugging."""

    datagrams = False

    def __init__(self, device: str, baud: int) -> None:
        self.name = f"{device},{baud}"
        self.counters = LinkCounters()
        self._device = device
        self._baud = baud
        self._epoll = select.epoll()
        self._number = 0
        self._retry_s = 0.0
        self._port: tuple[serial.Serial, Stream] | None = None
        try:
            self._open()
        except OSError:
            self._epoll.close()
            raise

    def _open(self) -> None:
        port = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0)
        os.set_blocking(port.fileno(), False)
        stream = Stream(port.fileno(), self._epoll, self.counters, empty_is_end=False)
        self._port = (port, stream)

    @property
    def peer_count(self) -> int:
        """1 while the device is there."""
        return int(self._port is not None)

    def fileno(self) -> int:
        """The epoll descriptor over the device."""
        return self._epoll.fileno()

    def read(self) -> list[Chunk]:
        """Reopen a lost device, continue pending writes, and collect what came."""
        if self._port is None:
            if time.monotonic() >= self._retry_s:
                self._retry_s = time.monotonic() + REOPEN_S
                with contextlib.suppress(OSError):
                    self._open()
            return []
        _, stream = self._port
        stream.flush()
        data, stands = stream.read()
        chunks = [(self._number, data)] if data else []
        gone = select.EPOLLHUP | select.EPOLLERR
        # A pulled USB adapter reads as empty for ever: only the hang-up shows it.
        hung_up = not data and any(mask & gone for _, mask in self._epoll.poll(0))
        if hung_up or not stands:
            self._lose()
            chunks.append((self._number, b""))
            # What comes after plugging in is another stream: half a frame of the old one stays
            # half.
            self._number += 1
        return chunks

    def write(self, data: bytes) -> None:
        """Send; while the device is gone the chunk is dropped, for it would be stale later."""
        if self._port is None:
            self.counters.drops += 1
        else:
            self._port[1].write(data)

    def _lose(self) -> None:
        self.counters.errors += 1
        self._retry_s = time.monotonic() + REOPEN_S
        if self._port is not None:
            self._port[1].abandon()
            self._port[0].close()
            self._port = None

    def close(self) -> None:
        """Close the device."""
        if self._port is not None:
            self._port[1].abandon()
            self._port[0].close()
            self._port = None
        self._epoll.close()


OPENERS = {"serial": SerialPort}
