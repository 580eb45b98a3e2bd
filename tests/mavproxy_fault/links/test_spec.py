import sys
from importlib.machinery import ModuleSpec
from types import ModuleType

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.spec import open_link, parse_spec


@pytest.mark.parametrize(
    ("text", "kind", "host", "port"),
    [
        ("udpin:0.0.0.0:14550", "udpin", "0.0.0.0", 14550),
        ("udpout:10.1.1.1:14550", "udpout", "10.1.1.1", 14550),
        ("udp:127.0.0.1:14550", "udpin", "127.0.0.1", 14550),
        ("127.0.0.1:14550", "udpin", "127.0.0.1", 14550),
        ("tcp:localhost:5760", "tcp", "localhost", 5760),
        ("tcpin:127.0.0.1:4560", "tcpin", "127.0.0.1", 4560),
        ("tcpin:[::1]:4560", "tcpin", "::1", 4560),
        ("udpin::14540", "udpin", "127.0.0.1", 14540),
        ("udpin://0.0.0.0:14540", "udpin", "0.0.0.0", 14540),
        ("udpout://192.168.1.12:14550", "udpout", "192.168.1.12", 14550),
        ("tcpout://127.0.0.1:5760", "tcp", "127.0.0.1", 5760),
        ("serial:///dev/ttyACM0:57600", "serial", "/dev/ttyACM0", 57600),
        ("/dev/ttyACM0,921600", "serial", "/dev/ttyACM0", 921600),
        ("/dev/ttyUSB0", "serial", "/dev/ttyUSB0", 115200),
        ("COM3,57600", "serial", "COM3", 57600),
    ],
)
def test_every_known_form_is_understood(text: str, kind: str, host: str, port: int) -> None:
    spec = parse_spec(text)
    assert (spec.kind, spec.host, spec.port) == (kind, host, port)


def test_an_output_sends_where_a_master_would_listen() -> None:
    assert parse_spec("127.0.0.1:14550", bare_udp="udpout").kind == "udpout"
    assert parse_spec("udp:127.0.0.1:14550", bare_udp="udpout").kind == "udpout"
    assert parse_spec("udpin:127.0.0.1:14550", bare_udp="udpout").kind == "udpin"


@pytest.mark.parametrize(
    "text",
    ["", "udpin", "udpin:14550", "udpin:127.0.0.1", "udpin:127.0.0.1:x", "udpin:127.0.0.1:70000",
     "udpout:127.0.0.1:0", "carrier:127.0.0.1:1", "/dev/ttyACM0,fast", "/dev/ttyACM0,0",
     "nonsense"],
)  # fmt: skip
def test_an_invalid_connection_string_is_refused_with_the_allowed_forms(text: str) -> None:
    with pytest.raises(ConfigError, match="; allowed: "):
        parse_spec(text)


def test_a_missing_device_is_a_user_error() -> None:
    with pytest.raises(ConfigError, match=r"/dev/no-such-tty,57600: cannot be opened"):
        open_link("/dev/no-such-tty,57600")


def test_an_address_in_use_is_a_user_error() -> None:
    first = open_link("udpin:127.0.0.1:0")
    try:
        with pytest.raises(ConfigError, match="cannot be opened: Address already in use"):
            open_link(first.name)
    finally:
        first.close()


@pytest.mark.parametrize("kind", ["udpin", "tcpin", "udpout", "tcp"])
def test_the_name_of_an_open_link_is_a_valid_connection_string(kind: str) -> None:
    try:
        link = open_link(f"{kind}:[::1]:{0 if kind.endswith('in') else 9}")
    except ConfigError as error:
        pytest.skip(str(error))
    link.close()
    assert parse_spec(link.name).host == "::1"


def test_another_kind_of_link_is_found_in_the_module_of_its_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened = []
    file = ModuleType("mavproxy_fault.links.carrier")
    file.__spec__ = ModuleSpec(file.__name__, None)
    file.OPENERS = {"carrier": lambda address, _: opened.append(address)}  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, file.__name__, file)
    open_link("carrier:pigeon/7")
    assert opened == ["pigeon/7"]
