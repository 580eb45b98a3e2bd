"""Hints for a link that cannot be opened: the owner of the port, the available devices."""

import errno
import os
import re
from contextlib import suppress
from pathlib import Path

PROC = Path("/proc")
SOCKET = re.compile(r"socket:\[(\d+)\]")


def open_hint(kind: str, host: str, port: int, error: OSError) -> str:
    """Return the hint that ends the error message, by kind of link and error."""
    # pyserial gives the error number only in its text.
    if kind == "serial":
        return f"allowed: {_devices()}"
    if error.errno == errno.EADDRINUSE:
        return (
            f"{describe_port_owner(port, tcp=kind == 'tcpin')}; allowed: a free port, or 0 for any"
        )
    if error.errno == errno.EADDRNOTAVAIL:
        scheme = "tcp" if kind == "tcpin" else "udpout"
        return f"it is not an address of this machine; to send there, use {scheme}:{host}:{port}"
    return "allowed: a free address or a device"


def _devices() -> str:
    from serial.tools.list_ports import comports

    names = ", ".join(sorted(port.device for port in comports()))
    return names or "a serial device (none found on this machine)"


def describe_port_owner(port: int, *, tcp: bool) -> str:
    """Name the process that owns a port, if this user's rights permit it."""
    inodes = _inodes(port, "tcp" if tcp else "udp")
    # The descriptors of other users' processes cannot be listed.
    for process in PROC.glob("[0-9]*"):
        with suppress(OSError):
            for descriptor in (process / "fd").iterdir():
                with suppress(OSError):
                    match = SOCKET.fullmatch(os.readlink(descriptor))
                    if match and match[1] in inodes:
                        name = (process / "comm").read_text().strip()
                        return f"port {port} is in use by {name} (process {process.name})"
    return f"port {port} is in use by another process"


def _inodes(port: int, protocol: str) -> set[str]:
    """Return the inodes of sockets bound to a port; empty on systems without /proc/net."""
    inodes = set()
    for file in (protocol, f"{protocol}6"):
        with suppress(OSError):
            for line in (PROC / "net" / file).read_text().splitlines()[1:]:
                columns = line.split()  # local address, ..., inode: see proc(5)
                if int(columns[1].rpartition(":")[2], 16) == port:
                    inodes.add(columns[9])
    return inodes
