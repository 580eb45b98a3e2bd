"""Serial devices: non-blocking, with a bounded queue, reopened after they were unplugged."""

import contextlib
import os
import select
import time
from functools import partial

import serial

from mavproxy_fault.links.descriptors import Descriptors
from mavproxy_fault.links.link import Chunk, LinkCounters
from mavproxy_fault.links.stream import Stream

try:
    import termios

    TerminalError: type[Exception] = termios.error  # not a subclass of OSError
except ImportError:  # Windows
    TerminalError = OSError

REOPEN_S = 0.5  # chosen: two attempts per second cost nothing


class SerialPort:
    """One device, which may be unplugged and plugged in again."""

    datagrams = False

    def __init__(self, device: str, baud: int) -> None:
        self.name = f"{device},{baud}"
        self.counters = LinkCounters()
        self._device = device
        self._baud = baud
        self._descriptors = Descriptors()
        self._number = 0
        self._retry_s = 0.0
        self._port: tuple[serial.Serial, Stream] | None = None
        try:
            self._open()
        except OSError:
            self._descriptors.close()
            raise

    def _open(self) -> None:
        try:
            port = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0)
        except TerminalError as error:
            raise OSError(*error.args) from error
        number = port.fileno()
        os.set_blocking(number, False)
        calls = partial(os.read, number), partial(os.write, number)
        stream = Stream(number, calls, self._descriptors, self.counters, empty_is_end=False)
        self._port = (port, stream)

    @property
    def peer_count(self) -> int:
        """1 while the device is open."""
        return int(self._port is not None)

    def filenos(self) -> list[int]:
        """Return the descriptor of the device while it is open."""
        return self._descriptors.filenos()

    def read(self) -> list[Chunk]:
        """Reopen a lost device, continue pending writes, and return received data."""
        if self._port is None:
            if time.monotonic() >= self._retry_s:
                self._retry_s = time.monotonic() + REOPEN_S
                with contextlib.suppress(OSError):
                    self._open()
            return []
        port, stream = self._port
        stream.flush()
        # Before the read: data arriving between the two calls must not look like a hang-up.
        readable = bool(select.select([port], (), (), 0)[0])
        data, is_open = stream.read()
        chunks = [(self._number, data)] if data else []
        # An unplugged USB adapter stays readable but returns no data.
        if (readable and not data) or not is_open:
            self._lose()
            chunks.append((self._number, b""))
            # Reopening starts a new stream: the old stream's incomplete frame is not continued.
            self._number += 1
        return chunks

    def write(self, data: bytes) -> None:
        """Send one chunk; it is dropped while the device is missing, as it would be stale later."""
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
        self._descriptors.close()


OPENERS = {"serial": SerialPort}
