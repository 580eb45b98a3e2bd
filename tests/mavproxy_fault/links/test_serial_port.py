import os
import select
import termios
from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links import serial_port, stream
from mavproxy_fault.links.serial_port import SerialPort
from mavproxy_fault.links.spec import open_link


def test_a_serial_device_carries_bytes_both_ways() -> None:
    master, slave = os.openpty()
    link = open_link(f"{os.ttyname(slave)},57600")
    os.write(master, b"\x00\xfd\x11\x13\r\n\xff")
    assert select.select(link.filenos(), [], [], 5)[0]
    assert link.read() == [(0, b"\x00\xfd\x11\x13\r\n\xff")]
    assert link.read() == []
    link.write(b"\n\x04\x80")
    assert os.read(master, 99) == b"\n\x04\x80"
    link.close()
    os.close(master)
    os.close(slave)


def test_an_unplugged_device_is_reopened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "REOPEN_S", 0.0)
    device = tmp_path / "tty"
    master, slave = os.openpty()
    device.symlink_to(os.ttyname(slave))
    link = SerialPort(str(device), 57600)
    os.close(slave)
    os.close(master)
    device.unlink()
    assert select.select(link.filenos(), [], [], 5)[0]
    assert link.read() == [(0, b"")]
    assert link.peer_count == 0
    link.write(b"lost")
    assert link.counters.drops == 1
    link.read()
    master, slave = os.openpty()
    device.symlink_to(os.ttyname(slave))
    link.read()
    assert link.peer_count == 1
    os.write(master, b"back")
    assert select.select(link.filenos(), [], [], 5)[0]
    assert link.read() == [(1, b"back")]
    link.close()
    os.close(master)
    os.close(slave)


def test_a_device_unplugged_during_opening_is_opened_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "REOPEN_S", 0.0)
    device = tmp_path / "tty"
    master, slave = os.openpty()
    device.symlink_to(os.ttyname(slave))
    link = SerialPort(str(device), 57600)
    os.close(slave)
    os.close(master)
    assert link.read() == [(0, b"")]
    device.unlink()
    master, slave = os.openpty()
    device.symlink_to(os.ttyname(slave))

    def gone(*_: object) -> None:
        raise serial_port.TerminalError(
            5, "Input/output error"
        )  # as the kernel reports once the other end is closed

    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(termios, "tcsetattr", gone)
        assert link.read() == []
        assert link.peer_count == 0
        with pytest.raises(ConfigError, match="cannot be opened: Input/output error"):
            open_link(f"{device},57600")
    link.read()
    assert link.peer_count == 1
    link.close()
    os.close(master)
    os.close(slave)
