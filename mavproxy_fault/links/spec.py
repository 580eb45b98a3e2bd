"""Connection strings: pymavlink's, as users know them, and MAVSDK's `scheme://` form.

    udpin:HOST:PORT    listen, answer everyone heard    udpout:HOST:PORT   send to
    tcp:HOST:PORT      TCP client                       tcpin:HOST:PORT    TCP server
    /dev/ttyACM0,57600 serial device and baud rate      serial:///dev/ttyACM0:57600

Any other `scheme:ADDRESS` is for the file of that name in this folder, if there is one.
`udp:HOST:PORT` and a bare `HOST:PORT` mean what they mean to MAVProxy: listen for a master, send
for an output. An empty host is 127.0.0.1; to listen on all interfaces say 0.0.0.0.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Literal

from mavproxy_fault import links
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.open_hint import open_hint

# Scheme to kind of link, and kind to the file of this folder whose OPENERS open it. A further
# kind is found in the file of its own name.
SCHEMES = {"udpin": "udpin", "udpout": "udpout", "tcp": "tcp", "tcpout": "tcp", "tcpin": "tcpin"}
FILES = {"udpin": "udp", "udpout": "udp", "tcpin": "tcp", "serial": "serial_port"}
ALLOWED = (
    "allowed: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT, "
    "DEVICE,BAUD or scheme://"
)
DEFAULT_BAUD = 115_200  # pymavlink's


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """What a connection string says; `host` is the device of a serial link, `port` its baud rate.

    For kinds of link that have a file of their own, `host` is all that follows the scheme.
    `text` is the string as the user wrote it, for messages.
    """

    kind: str
    host: str
    port: int
    text: str


def parse_spec(text: str, *, bare_udp: Literal["udpin", "udpout"] = "udpin") -> LinkSpec:
    """Read a connection string; `bare_udp` is what `udp:` and a bare HOST:PORT stand for.

    Raises
    ------
    ConfigError
        If the string has none of the known forms.
    """
    found = re.fullmatch(r"([a-z_]+)://(.*)", text) or re.fullmatch(r"([a-z]+):(.*)", text)
    scheme, rest = (found[1], found[2]) if found else ("", text)
    if scheme == "serial":
        return _serial(text, rest.replace(",", ":"))
    kind = bare_udp if scheme == "udp" else SCHEMES.get(scheme)
    if kind is None and re.fullmatch(r"[^:,/]+:\d+", text):
        kind, rest = bare_udp, text
    if kind is None:
        if scheme and scheme in _openers(scheme):
            return LinkSpec(scheme, rest, 0, text)
        if text.startswith("/") or re.fullmatch(r"COM\d+(,\d+)?", text):
            return _serial(text, text.replace(",", ":"))
        raise ConfigError(f"{text or repr(text)}: is not a connection string; {ALLOWED}")
    return _socket(kind, text, rest)


def _socket(kind: str, text: str, rest: str) -> LinkSpec:
    found = re.fullmatch(r"(?:\[(?P<six>[^\]]+)\]|(?P<host>[^:]*)):(?P<port>\d{1,5})", rest)
    if found is None:
        raise ConfigError(f"{text}: has no HOST:PORT after its scheme; {ALLOWED}")
    port = int(found["port"])
    if port > 0xFFFF:
        raise ConfigError(f"{text}: port {port} is too large; allowed: 0 to 65535")
    if port == 0 and kind in ("udpout", "tcp"):
        raise ConfigError(f"{text}: port 0 cannot be sent to; allowed: 1 to 65535")
    return LinkSpec(kind, found["six"] or found["host"] or "127.0.0.1", port, text)


def _serial(text: str, rest: str) -> LinkSpec:
    device, _, baud = rest.partition(":")
    if not device or (baud and not baud.isdigit()) or baud == "0":
        raise ConfigError(f"{text}: is not a serial device; allowed: DEVICE or DEVICE,BAUD")
    return LinkSpec("serial", device, int(baud or DEFAULT_BAUD), text)


def open_link(spec: str | LinkSpec, *, bare_udp: Literal["udpin", "udpout"] = "udpin") -> Link:
    """Open a link by its connection string.

    Raises
    ------
    ConfigError
        If the string is wrong, or the address or device cannot be opened.
    """
    if isinstance(spec, str):
        spec = parse_spec(spec, bare_udp=bare_udp)
    try:
        return _open(spec)
    except OSError as error:
        # Where Python itself adds the address, it would stand there twice.
        reason = (error.strerror or str(error)).partition(" (while attempting")[0]
        hint = open_hint(spec.kind, spec.host, spec.port, error)
        raise ConfigError(f"{spec.text}: cannot be opened: {reason}; {hint}") from error


def _open(spec: LinkSpec) -> Link:
    # Its devices are no files on Windows, and `select` does not wait for them.
    if spec.kind == "serial" and find_spec("termios") is None:
        raise ConfigError(
            f"{spec.text}: serial devices need termios, which this system has not; "
            "allowed here: udpin, udpout, tcp, tcpin"
        )
    opener = _openers(FILES.get(spec.kind, spec.kind))[spec.kind]
    return opener(spec.host, spec.port)


def _openers(file: str) -> dict[str, Callable[[str, int], Link]]:
    """What opens the kinds of link of one file of this folder; empty where there is no such."""
    name = f"{links.__name__}.{file}"
    if find_spec(name) is None:
        return {}
    found: dict[str, Callable[[str, int], Link]] = getattr(import_module(name), "OPENERS", {})
    return found
