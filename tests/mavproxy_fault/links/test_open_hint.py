import os
from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links import open_hint
from mavproxy_fault.links.spec import open_link


@pytest.mark.parametrize("scheme", ["udpin", "tcpin"])
def test_the_error_names_the_process_that_owns_the_port(scheme: str) -> None:
    first = open_link(f"{scheme}:127.0.0.1:0")
    port = first.name.rsplit(":", 1)[1]
    try:
        with pytest.raises(ConfigError) as caught:
            open_link(f"{scheme}:127.0.0.1:{port}")
    finally:
        first.close()
    name = Path("/proc/self/comm").read_text().strip()
    assert str(caught.value) == (
        f"{scheme}:127.0.0.1:{port}: cannot be opened: Address already in use; port {port} is "
        f"in use by {name} (process {os.getpid()}); allowed: a free port, or 0 for any"
    )


def test_the_owner_of_a_port_is_not_named_if_the_system_hides_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(open_hint, "PROC", tmp_path)
    assert (
        open_hint.describe_port_owner(14550, tcp=False) == "port 14550 is in use by another process"
    )


def test_listening_on_a_remote_address_points_to_sending() -> None:
    # Reserved for documentation (RFC 5737): no machine has it.
    with pytest.raises(ConfigError, match=r"; to send there, use udpout:192\.0\.2\.1:14550$"):
        open_link("udpin:192.0.2.1:14550")
    with pytest.raises(ConfigError, match=r"; to send there, use tcp:192\.0\.2\.1:14550$"):
        open_link("tcpin:192.0.2.1:14550")


def test_a_missing_device_lists_those_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    from serial.tools import list_ports, list_ports_common

    devices = [list_ports_common.ListPortInfo(name) for name in ("/dev/ttyUSB1", "/dev/ttyACM0")]
    monkeypatch.setattr(list_ports, "comports", lambda: devices)
    with pytest.raises(ConfigError, match=r"; allowed: /dev/ttyACM0, /dev/ttyUSB1$"):
        open_link("/dev/no-such-tty,57600")
