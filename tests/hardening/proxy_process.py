"""A proxy started as by a user, a vehicle that sends to it and a station that receives."""

import contextlib
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

TIMEOUT_S = 60.0  # on a busy machine

# libfaketime (Debian's `faketime`), which gives a process another clock, including Zenoh and
# compiled code; "" if it is not installed.
CLOCK_LIBRARY = os.environ.get("FAKETIME_LIBRARY") or str(
    next(iter(sorted(Path("/usr/lib").glob("*/faketime/libfaketime.so.1"))), "")
)


def numbered(number: int) -> bytes:
    """A frame that contains its number, with a timestamp that starts the schedule."""
    values = {"time_boot_ms": number, "yaw": float(number)}
    return build_frame(message_layout("ATTITUDE"), values, seq=number & 255)


def number_of(frame: bytes) -> int:
    """The number of such a frame."""
    return int.from_bytes(frame[10:14], "little")  # time_boot_ms, the first field of the payload


@dataclass
class Driven:
    """The process, the vehicle's and the station's socket."""

    process: "subprocess.Popen[str]"
    vehicle: socket.socket
    station: socket.socket
    sent: int = 0

    def pass_frame(self) -> bytes:
        """Send the next frame and wait until it leaves the proxy, ignoring other frames."""
        self.sent += 1
        self.vehicle.send(numbered(self.sent))
        while number_of(raw := self.station.recv(999)) != self.sent or raw[7:10] != b"\x1e\0\0":
            pass
        return raw

    def end(self) -> tuple[str, str]:
        """Stop it; return its standard output and standard error."""
        self.process.terminate()
        printed, errors = self.process.communicate(timeout=TIMEOUT_S)
        assert self.process.returncode == 0, errors
        return printed, errors


@contextlib.contextmanager
def driven(
    *options: str, limits: str = "true", folder: Path | None = None, **environment: str
) -> Iterator[Driven]:
    """A proxy between a vehicle and a station on UDP; `limits` is a shell command run first."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
    ):
        station.bind(("127.0.0.1", 0))
        station.settimeout(TIMEOUT_S)
        to = f"udpout:127.0.0.1:{station.getsockname()[1]}"
        command = [sys.executable, "-m", "mavproxy_fault.cli", "proxy", "--to", to]
        command += ["--master", "udpin:127.0.0.1:0", *options]
        with subprocess.Popen(
            ["sh", "-c", f'{limits}; exec "$@"', "sh", *command], cwd=folder, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, env={**os.environ, **environment},
        ) as process:  # fmt: skip
            assert process.stdout is not None
            ready = process.stdout.readline()
            assert ready.startswith("ready: "), process.communicate()
            vehicle.connect(("127.0.0.1", int(ready.split()[1].rsplit(":", 1)[1])))
            try:
                yield Driven(process, vehicle, station)
            finally:
                process.kill()
