"""What helps a user whose link cannot be opened: who holds the port, which devices there are."""

import errno
import os
import re
from contextlib import suppress
from pathlib import Path

PROC = Path("/proc")
SOCKET = re.compile(r"socket:\[(\d+)\]")


def open_hint(kind: str, host: str, port: int, error: OSError) -> str:
    """The end of an error's sentence, by the kind of link and what went wrong."""
    # pyserial tells the number only in its text.
    if kind == "serial":
        return f"allowed: {_devices()}"
    if error.errno == errno.EADDRINUSE:
        return (
            f"{describe_port_owner(port, tcp=kind == 'tcpin')}; allowed: a free port, or 0 for any"
        )
    if error.errno == errno.EADDRNOTAVAIL:
        scheme = "tcp" if kind == "tcpin" else "udpout"
        return f"it is no address of this machine; to send there say {scheme}:{host}:{port}"
    return "allowed: a free address or a device"


def _devices() -> str:
    from serial.tools.list_ports import comports

    names = ", ".join(sorted(port.device for port in comports()))
    return names or "a serial device, of which there is none here"


def describe_port_owner(port: int, *, tcp: bool) -> str:
    """Who has a port, as far as this system and this user's rights show it."""
    inodes = _inodes(port, "tcp" if tcp else "udp")
    # Other users' processes have descriptors that cannot be listed.
    for process in PROC.glob("[0-9]*"):
        with suppress(OSError):
            for descriptor in (process / "fd").iterdir():
                with suppress(OSError):
                    found = SOCKET.fullmatch(os.readlink(descriptor))
                    if found and found[1] in inodes:
                        name = (process / "comm").read_text().strip()
                        return f"port {port} is held by {name} (process {process.name})"
    return f"port {port} is held by another process"


def _inodes(port: int, protocol: str) -> set[str]:
    """The numbers of the sockets that are bound to a port; none where there is no /proc/net."""
    found = set()
    for file in (protocol, f"{protocol}6"):
        with suppress(OSError):
            for line in (PROC / "net" / file).read_text().splitlines()[1:]:
                words = line.split()  # local address, ..., inode: see proc(5)
                if int(words[1].rpartition(":")[2], 16) == port:
                    found.add(words[9])
    return found
