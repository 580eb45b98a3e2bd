"""The user at the other end of a loopback connection, from the kernel's table of sockets.

References
----------
.. [1] Linux kernel, Documentation/networking/proc_net_tcp.rst.
"""

import socket
from contextlib import suppress
from pathlib import Path

TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
MAPPED = "0000000000000000FFFF0000"  # an IPv4 address in a socket of IPv6
HAS_TABLES = TABLES[0].exists()

Address = tuple[str, int]


def peer_user(client: Address, server: Address) -> int | None:
    """Return the user id of the process that holds a connection's other end; None if unknown."""
    wanted = _encode(client), _encode(server)
    for table in TABLES:
        with suppress(OSError):
            for line in table.read_text().splitlines()[1:]:
                _, local, remote, _, _, _, _, user, _, inode, *_ = line.split()
                # A socket that its process has closed has no inode, and seems to be root's.
                if (local.removeprefix(MAPPED), remote.removeprefix(MAPPED)) == wanted:
                    return int(user) if inode != "0" else None
    return None


def _encode(address: Address) -> str:
    """Return an address as in the table: the IPv4 address little-endian, and the port."""
    host = socket.inet_aton(address[0])[::-1].hex().upper()
    return f"{host}:{address[1]:04X}"
