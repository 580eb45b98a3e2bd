"""Connection strings in pymavlink's form and in MAVSDK's `scheme://` form.

    udpin:HOST:PORT    listen, answer all peers         udpout:HOST:PORT   send to
    tcp:HOST:PORT      TCP client                       tcpin:HOST:PORT    TCP server
    /dev/ttyACM0,57600 serial device and baud rate      serial:///dev/ttyACM0:57600

Any other `scheme:ADDRESS` is opened by the module of that name in this package, if there is one.
`udp:HOST:PORT` and `HOST:PORT` mean the same as in MAVProxy: listen for a master, send for an
output. An empty host is 127.0.0.1; to listen on all interfaces, use 0.0.0.0.
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

# Scheme to kind of link, and kind to the module of this package whose OPENERS open it. The module
# of any other kind has the name of the kind.
SCHEMES = {"udpin": "udpin", "udpout": "udpout", "tcp": "tcp", "tcpout": "tcp", "tcpin": "tcpin"}
FILES = {"udpin": "udp", "udpout": "udp", "tcpin": "tcp", "serial": "serial_port"}
ALLOWED = (
    "allowed: udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT, "
    "DEVICE,BAUD or scheme://"
)
DEFAULT_BAUD = 115_200  # pymavlink's


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """A parsed connection string; a serial link has its device as `host`, its baud rate as `port`.

    For other kinds of link with a module of their own, `host` is everything after the scheme.
    `text` is the string as the user wrote it, for messages.
    """

    kind: str
    host: str
    port: int
    text: str


def parse_spec(text: str, *, bare_udp: Literal["udpin", "udpout"] = "udpin") -> LinkSpec:
    """Parse a connection string; `bare_udp` is the meaning of `udp:` and a bare HOST:PORT.

    Raises
    ------
    ConfigError
        If the string is in none of the known forms.
    """
    match = re.fullmatch(r"([a-z_]+)://(.*)", text) or re.fullmatch(r"([a-z]+):(.*)", text)
    scheme, rest = (match[1], match[2]) if match else ("", text)
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
    match = re.fullmatch(r"(?:\[(?P<six>[^\]]+)\]|(?P<host>[^:]*)):(?P<port>\d{1,5})", rest)
    if match is None:
        raise ConfigError(f"{text}: has no HOST:PORT after its scheme; {ALLOWED}")
    port = int(match["port"])
    if port > 0xFFFF:
        raise ConfigError(f"{text}: port {port} is too large; allowed: 0 to 65535")
    if port == 0 and kind in ("udpout", "tcp"):
        raise ConfigError(f"{text}: port 0 cannot be sent to; allowed: 1 to 65535")
    return LinkSpec(kind, match["six"] or match["host"] or "127.0.0.1", port, text)


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
        If the string is invalid, or the address or device cannot be opened.
    """
    if isinstance(spec, str):
        spec = parse_spec(spec, bare_udp=bare_udp)
    try:
        return _open(spec)
    except OSError as error:
        # Python may add the address itself, which would repeat it.
        reason = (error.strerror or str(error)).partition(" (while attempting")[0]
        hint = open_hint(spec.kind, spec.host, spec.port, error)
        raise ConfigError(f"{spec.text}: cannot be opened: {reason}; {hint}") from error


def _open(spec: LinkSpec) -> Link:
    # On Windows serial devices are not files, and `select` cannot wait for them.
    if spec.kind == "serial" and find_spec("termios") is None:
        raise ConfigError(
            f"{spec.text}: serial devices need termios, which this system lacks; "
            "allowed here: udpin, udpout, tcp, tcpin"
        )
    opener = _openers(FILES.get(spec.kind, spec.kind))[spec.kind]
    return opener(spec.host, spec.port)


def _openers(file: str) -> dict[str, Callable[[str, int], Link]]:
    """Return the OPENERS of a module of this package; empty if there is no such module."""
    name = f"{links.__name__}.{file}"
    if find_spec(name) is None:
        return {}
    openers: dict[str, Callable[[str, int], Link]] = getattr(import_module(name), "OPENERS", {})
    return openers
