"""The bridge's sockets to ArduPilot, all on the loopback address."""

import contextlib
import socket

from mavproxy_fault.ardupilot.feeding.vectornav import BinaryOutput
from mavproxy_fault.ardupilot.feeding.vectornav_handshake import Handshake
from mavproxy_fault.links.link import Link, enlarge_buffers
from mavproxy_fault.links.tcp import TcpServer

LOOPBACK = "127.0.0.1"
DATAGRAM = 65_536


class Datagrams:
    """A UDP port with one peer, the last sender."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOOPBACK, 0))
        self._socket.setblocking(False)
        enlarge_buffers(self._socket)
        self.port: int = self._socket.getsockname()[1]
        self._peer: tuple[str, int] | None = None

    def fileno(self) -> int:
        """The descriptor for `select`."""
        return self._socket.fileno()

    def read(self) -> list[bytes]:
        """Return the oldest waiting datagram; the port stays readable while there are more."""
        # A step is one datagram: checking for a second one would double the cost.
        try:
            data, self._peer = self._socket.recvfrom(DATAGRAM)
        except (BlockingIOError, ConnectionRefusedError):
            return []
        return [data]

    def write(self, data: bytes) -> None:
        """Send to the peer; dropped if there is none yet."""
        if self._peer is not None:
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                self._socket.sendto(data, self._peer)

    def close(self) -> None:
        """Close the port."""
        self._socket.close()


class SensorPort:
    """The VectorNav's serial device: replies to its configuration, then sends its outputs."""

    def __init__(self, link: Link | None = None) -> None:
        self._link = link or TcpServer(LOOPBACK, 0)
        self._handshake = Handshake()

    @property
    def port(self) -> int:
        """The TCP port; 0 for a serial device."""
        return getattr(self._link, "port", 0)

    def fileno(self) -> int:
        """The descriptor for `select`."""
        return self._link.filenos()[0]

    def serve(self) -> None:
        """Reply to the driver's commands."""
        for _, data in self._link.read():
            if data:
                self._link.write(self._handshake.received(data))
            else:
                self._handshake = Handshake()  # a new connection configures the sensor again

    @property
    def outputs(self) -> tuple[BinaryOutput, ...]:
        """The outputs that the driver has configured."""
        return self._handshake.outputs

    def write(self, data: bytes) -> None:
        """Send packets, if there are any."""
        if data:
            self._link.write(data)

    def close(self) -> None:
        """Close the device."""
        self._link.close()
