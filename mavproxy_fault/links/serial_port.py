"""Serial devices: non-blocking, with a bounded queue, reopened after they were unplugged."""

import os
import select
from functools import partial
from typing import Any

import serial

from mavproxy_fault.links.stream import ReopenedLink, Stream

try:
    import termios

    TerminalError: type[Exception] = termios.error  # not a subclass of OSError
except ImportError:  # Windows
    TerminalError = OSError


class SerialPort(ReopenedLink):
    """One device, which may be unplugged and plugged in again."""

    def __init__(self, device: str, baud: int) -> None:
        super().__init__(f"{device},{baud}")
        self._device = device
        self._baud = baud
        try:
            self._peer = self._open()
        except OSError:
            self._descriptors.close()
            raise

    def _open(self) -> tuple[Any, Stream]:
        try:
            port = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0)
        except TerminalError as error:
            raise OSError(*error.args) from error
        number = port.fileno()
        os.set_blocking(number, False)
        calls = partial(os.read, number), partial(os.write, number)
        return port, Stream(number, calls, self._descriptors, self.counters, empty_is_end=False)

    def _read(self, port: Any, stream: Stream) -> tuple[bytes, bool]:
        # Before the read: data arriving between the two calls must not look like a hang-up.
        readable = bool(select.select([port], (), (), 0)[0])
        data, is_open = stream.read()
        # An unplugged USB adapter stays readable but returns no data.
        return data, is_open and (not readable or bool(data))


OPENERS = {"serial": SerialPort}
