"""The page beside a run: it shows what goes over the bus, so that it needs one."""

import socket
from pathlib import Path

import pytest

from analysis.web import page_server
from mavproxy_fault.cli import main
from mavproxy_fault.links import bus


def test_a_page_without_a_bus_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with socket.socket() as foreign:
        foreign.bind(("127.0.0.1", 0))
        foreign.listen()
        url = f"tcp/127.0.0.1:{foreign.getsockname()[1]}"
        monkeypatch.setattr(page_server, "DEFAULT_URL", url)
        monkeypatch.setattr(bus, "OPEN_MS", 300)
        assert main(["run", "--ui", "--out", str(tmp_path / "out")]) == 2
    assert "cannot be opened" in capsys.readouterr().err
