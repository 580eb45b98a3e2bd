import itertools
import json
import select
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from mavproxy_fault.cli import main
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links import bus
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.rflysim import read_map
from mavproxy_fault.live.session import LiveSession
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import Schedule


class Loop:
    """A proxy's loop with live control only."""

    def __init__(self) -> None:
        self.engine = Engine(Schedule(1))
        self.engine.start_at(1_000_000)
        self.live = LiveSession(LiveControl(self.engine, rflysim=read_map()), lambda: 5_000_000)
        self.live.open_bus("tcp/127.0.0.1:0")
        self.port = self.live.open_rflysim(0)
        self._stop, self._stopped = socket.socketpair()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while True:
            ready, _, _ = select.select([self._stopped, *self.live.filenos()], (), ())
            if self._stopped in ready:
                return
            self.live.serve()

    def close(self) -> None:
        self._stop.send(b"!")
        self._thread.join()
        self.live.close()
        self._stop.close()
        self._stopped.close()


@pytest.fixture
def loop() -> Iterator[Loop]:
    running = Loop()
    yield running
    running.close()


def inject(loop: Loop, *words: str) -> int:
    assert loop.live.bus.url is not None
    return main(["inject", *words, "--zenoh", loop.live.bus.url])


def test_inject_arms_changes_and_clears_a_fault(loop: Loop) -> None:
    gyro = ["bias", "--target", "HIL_SENSOR.xgyro"]
    assert inject(loop, *gyro, "--value", "0.1", "--for", "5") == 0
    (fault,) = loop.engine.state()["faults"]
    assert (fault["id"], fault["state"], fault["parameters"]) == ("bias", "active", {"value": 0.1})
    assert fault["end_us"] == 10_000_000
    assert inject(loop, *gyro, "--value", "0.2") == 0
    assert loop.engine.state()["faults"][0]["parameters"] == {"value": 0.2}
    assert inject(loop, "--clear", "bias") == 0
    assert loop.engine.ids() == []


def test_inject_takes_presets_and_clears_all(loop: Loop) -> None:
    assert inject(loop, "imu-impulse") == 0
    assert inject(loop, "baro-freeze") == 0
    assert loop.engine.ids() == ["imu-impulse.1", "imu-impulse.2", "baro-freeze"]
    assert inject(loop, "--clear", "all") == 0
    assert loop.engine.ids() == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["bais"], "did you mean"),
        (["bias", "--target", "HIL_SENSOR.xgyr", "--value", "1"], "did you mean xgyro"),
        (["--clear", "nothing"], "nothing is not a fault; none exist"),
        (["--clear", "a*"], "--clear: id = 'a*' is not valid"),
        (
            ["--clear", "\udcf0"],
            "is not valid; give up to 200",
        ),  # not ASCII, in a shell with ASCII encoding
        (["baro-freeze", "--id", "@x"], "inject: id = '@x' is not valid"),
        (["baro-freeze", "--id", ""], "is not valid; give up to 200"),
        (["baro-freeze", "--id", "x" * 70_000], "is not valid; give up to 200"),
        (["baro-freeze", "--run", "*"], "--run '*' cannot be a key"),
        (["baro-freeze", "--run", ""], "--run '' cannot be a key"),
        ([], "give one of FAULT, --clear ID and --list"),
        (["bias", "--list"], "give one of"),
        (["noise", "--target", "HIL_SENSOR.xgyro", "--set", "spread"], "is not KEY=VALUE"),
        (["noise", "--target", "HIL_SENSOR.xgyro", "--set", "spread=1"], "spread"),
    ],
)
def test_inject_reports_errors(
    loop: Loop, words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert inject(loop, *words) == 2
    assert said in capsys.readouterr().err


def test_inject_sets_any_key_of_an_entry_and_lists_faults(
    loop: Loop, capsys: pytest.CaptureFixture[str]
) -> None:
    assert inject(loop, "--list") == 0
    assert capsys.readouterr().out == "no faults\n"
    keys = ["--set", "probability=0.25", "--set", "repeat={every_s: 20}"]
    assert inject(loop, "drop", "--target", "HIL_GPS", *keys, "--for", "2", "--id", "gaps") == 0
    saved = loop.engine.save()
    assert "probability: 0.25" in saved
    assert "every_s: 20" in saved
    capsys.readouterr()
    assert inject(loop, "--list") == 0
    head, line = capsys.readouterr().out.splitlines()
    assert head.split() == ["id", "state", "fault", "from", "s", "to", "s", "frames", "target"]
    assert line.split() == ["gaps", "active", "drop", "4.0", "6.0", "0", "HIL_GPS"]


def test_a_running_schedule_is_loaded_shown_saved_and_cleared(
    loop: Loop, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def schedule(*words: str) -> tuple[int, str]:
        assert loop.live.bus.url is not None
        code = main(["schedule", *words, "--zenoh", loop.live.bus.url])
        return code, capsys.readouterr().out

    good, wrong, saved = (tmp_path / name for name in ("good.yaml", "wrong.yaml", "saved.yaml"))
    good.write_text("faults:\n- {id: still, fault: freeze, target: HIL_SENSOR.zacc}\n")
    wrong.write_text("faults:\n- {id: still, fault: freeez, target: HIL_SENSOR.zacc}\n")
    assert schedule("load", str(good)) == (0, "1 fault loaded: still\n")
    assert schedule("load", str(wrong))[0] == 2
    assert loop.engine.ids() == ["still"]
    assert schedule("save", str(saved))[0] == 0
    assert "id: still" in saved.read_text()
    assert schedule("save") == (0, saved.read_text())
    assert '"id": "still"' in schedule("state")[1]
    assert schedule("clear")[0] == 0
    assert loop.engine.ids() == []


def test_inject_without_a_proxy_fails(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        url = f"tcp/127.0.0.1:{unused.getsockname()[1]}"
        assert main(["inject", "baro-freeze", "--zenoh", url]) == 2
    assert url in capsys.readouterr().err


def test_auto_is_the_default_address_of_clients_too(
    loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bus, "DEFAULT_URL", loop.live.bus.url)
    assert main(["inject", "--list", "--zenoh", "auto"]) == 0
    assert main(["inject", "--list"]) == 0


def test_an_invalid_port_is_refused() -> None:
    live = LiveSession(LiveControl(Engine(Schedule(1))), lambda: 0)
    with pytest.raises(ConfigError, match="--rflysim 99999"):
        live.open_rflysim(99_999)
    live.close()


def test_rflysim_packets_reach_the_engine(loop: Loop) -> None:
    numbers = [1234567897, 1, 123455, *[0] * 7, 4.0, 1.5, *[0.0] * 18]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(struct.pack("<10i20f", *numbers), ("127.0.0.1", loop.port))  # type: ignore[arg-type]
    deadline = threading.Event()
    for _ in range(500):
        if loop.engine.ids():
            break
        deadline.wait(0.01)
    assert loop.engine.ids() == ["rflysim-1-123455.1"]


def test_a_request_may_only_name_allowed_files(loop: Loop, tmp_path: Path) -> None:
    secret, allowed = tmp_path / "secret.csv", tmp_path / "tables"
    secret.write_text("the first line of it\n")
    allowed.mkdir()
    (allowed / "table.csv").write_text("t_s,value\n0,1\n")
    loop.live.control.folders = [allowed]

    def entry(path: Path) -> dict[str, Any]:
        profile = {"table": {"file": str(path)}}
        return {"fault": "bias", "target": "HIL_SENSOR.xgyro", "profile": profile}

    for link in (secret, allowed / ".." / "secret.csv"):
        with pytest.raises(ConfigError, match="must not be named") as caught:
            loop.live.query("@ctl/fault/a/arm", msgspec.json.encode(entry(link)))
        assert "first line" not in str(caught.value)
        schedule = json.dumps({"faults": [{**entry(link), "id": "a"}]}).encode()
        with pytest.raises(ConfigError, match="must not be named"):
            loop.live.query("@ctl/schedule/load", schedule)
    (allowed / "link.csv").symlink_to(secret)
    with pytest.raises(ConfigError, match="must not be named"):
        loop.live.query("@ctl/fault/a/arm", msgspec.json.encode(entry(allowed / "link.csv")))
    reply = loop.live.query("@ctl/fault/a/arm", msgspec.json.encode(entry(allowed / "table.csv")))
    assert reply == {"armed": ["a"]}


def test_proxies_of_one_router_have_different_names(
    loop: Loop, capsys: pytest.CaptureFixture[str]
) -> None:
    second = LiveSession(LiveControl(Engine(Schedule(1))), lambda: 0)
    with pytest.raises(ConfigError, match="--run live is taken"):
        second.open_bus(loop.live.bus.url or "", "live")
    second.open_bus(loop.live.bus.url or "")
    assert second.bus.run == "live-2"
    assert inject(loop, "bias", "--target", "HIL_SENSOR.xgyro", "--value", "1") == 2
    assert "live, live-2" in capsys.readouterr().err
    second.close()


def test_a_proxy_takes_over_when_the_router_ends() -> None:
    first = LiveSession(LiveControl(Engine(Schedule(1))), lambda: 0)
    first.open_bus("tcp/127.0.0.1:0", "first")
    url = first.bus.url or ""
    second = LiveSession(LiveControl(Engine(Schedule(1))), lambda: 0)
    second.open_bus(url, "second")
    assert not second.bus.is_router
    first.close()
    for now_s in itertools.count(1.0):
        second.show(now_s)
        select.select(second.filenos(), (), (), 0.05)
        second.serve()
        if second.bus.is_router:
            break
        assert now_s < 400
    answers: list[int] = []
    asker = threading.Thread(
        target=lambda: answers.append(main(["inject", "--clear", "all", "--zenoh", url]))
    )
    asker.start()
    while asker.is_alive():
        select.select(second.filenos(), (), (), 0.05)
        second.serve()
    asker.join()
    assert answers == [0]
    second.close()


def test_a_query_to_a_proxy_that_ends_fails_at_once() -> None:
    live = LiveSession(LiveControl(Engine(Schedule(1))), lambda: 0)
    errors: list[str] = []

    def ask() -> None:
        try:
            live.query("@ctl/state", b"")
        except ConfigError as error:
            errors.append(str(error))

    asker = threading.Thread(target=ask)
    asker.start()
    assert select.select(live.filenos(), (), (), 10)[0]  # never served
    live._requests.serve = lambda: None  # type: ignore[method-assign]
    live.close()
    asker.join(1)
    assert not asker.is_alive()
    assert "ended" in errors[0]
