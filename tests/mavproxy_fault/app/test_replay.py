import argparse
import socket
import threading
from pathlib import Path

import pytest
import yaml

from mavproxy_fault.app.proxy_command import link_roles
from mavproxy_fault.app.recorder import Recorder
from mavproxy_fault.app.replaying import replay
from mavproxy_fault.app.replaying.playback import open_log, split_records
from mavproxy_fault.app.server import Server
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.udp import UdpClient, UdpServer
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame
from mavproxy_fault.wire.label import read_labels

SCHEDULE = """
seed: 5
faults:
  - {id: noisy, fault: noise, target: HIL_SENSOR.xgyro, value: 0.1, at_s: 0.1, for_s: 0.3}
  - {id: late, fault: delay, target: HIL_SENSOR, value: 0.003, at_s: 0.2, for_s: 0.4}
  - {id: loss, fault: drop, target: HEARTBEAT, probability: 0.5}
"""
QUIET = "faults: [{id: never, fault: bias, target: HIL_SENSOR.xgyro, value: 1, at_s: 100000}]"


def arguments(log: Path, schedule: str, tmp_path: Path, **chosen: str | None) -> argparse.Namespace:
    path = tmp_path / "schedule.yaml"
    path.write_text(schedule)
    rest = {"out": None, "link": None, "signing_key": None, "strip_signatures": False, **chosen}
    return argparse.Namespace(log=str(log), schedule=str(path), **rest)


def sensor(step: int, component: int = 51) -> bytes:
    values = {"time_usec": 1_000_000 + step * 4000, "xgyro": 0.5, "fields_updated": 63}
    return build_frame(message_layout("HIL_SENSOR"), values, seq=step & 255, component=component)


def heartbeat(step: int) -> bytes:
    return build_frame(message_layout("HEARTBEAT"), {"type": 2}, seq=step & 255)


def record_a_live_session(folder: Path) -> None:
    """Run a server with links on loopback between a simulator and an autopilot."""
    master = UdpServer("127.0.0.1", 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sim:
        sim.bind(("127.0.0.1", 0))
        sim.settimeout(10)
        links = [master, UdpClient(*sim.getsockname())]
        tape = CaptureBuffer()
        core = Core(link_roles(links), Engine(parse_schedule(SCHEDULE)), tape=tape)
        server = Server(links, core, tape=tape, recorder=Recorder(folder, {
            "links": [{"name": role.name, "direction": role.direction} for role in core.links],
            "schedule": yaml.safe_load(SCHEDULE),
        }))  # fmt: skip
        loop = threading.Thread(target=server.run)
        loop.start()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as autopilot:
            autopilot.connect(("127.0.0.1", master.port))
            autopilot.settimeout(10)
            autopilot.send(b"here I am")
            assert sim.recv(999) == b"here I am"
            proxy = links[1].sock.getsockname()
            for step in range(150):
                sim.sendto(sensor(step) + (b"\xfd\x01junk" if step % 7 == 0 else b""), proxy)
                if step < 40:
                    autopilot.recv(999)
                autopilot.send(heartbeat(step))
            sim.sendto(b"the end", proxy)
            while autopilot.recv(999) != b"the end":
                pass
        server.stop()
        loop.join(10)
        for link in links:
            link.close()


def test_a_replay_with_its_own_schedule_reproduces_the_sent_bytes(
    tmp_path: Path,
) -> None:
    live = tmp_path / "live"
    record_a_live_session(live)
    out = tmp_path / "again.tlog"
    assert replay.main(arguments(live / "received.tlog", SCHEDULE, tmp_path, out=str(out))) == 0
    assert out.read_bytes() == (live / "sent.tlog").read_bytes()
    assert out.with_suffix(".labels.jsonl").read_bytes() == (live / "labels.jsonl").read_bytes()
    ids = {label.id for label in read_labels(live / "labels.jsonl")}
    assert ids == {"noisy", "late", "loss"}


@pytest.mark.parametrize(
    "log", ["px4_hil/hover_gps_jump_gcs.tlog", "tlog/dronekit_flight_replay.tlog"]
)
def test_a_real_log_is_unchanged_without_active_faults(
    log: str, shared_data: Path, tmp_path: Path
) -> None:
    whole = (shared_data / log).read_bytes()
    records = list(split_records(whole))
    assert sum(8 + len(raw) for _, raw in records) == len(whole)
    part = tmp_path / "part.tlog"
    part.write_bytes(b"".join(t.to_bytes(8, "big") + raw for t, raw in records[:6000]))
    out = tmp_path / "out.tlog"
    replay.main(arguments(part, QUIET, tmp_path, out=str(out)))
    assert out.read_bytes() == part.read_bytes()


def test_directions_of_a_foreign_log_follow_from_the_sender(tmp_path: Path) -> None:
    log = tmp_path / "foreign.tlog"
    station = build_frame(message_layout("HEARTBEAT"), {"type": 6}, system=255, component=190)
    simulator = [sensor(step, component=7) for step in range(2)]
    frames = [heartbeat(0), station, *simulator, heartbeat(1)]
    log.write_bytes(b"".join((10**15 + n).to_bytes(8, "big") + raw for n, raw in enumerate(frames)))
    source = open_log(log)
    assert [source.roles[r.link].direction for r in source.records] == [
        "from-vehicle", "to-vehicle", "to-vehicle", "to-vehicle", "from-vehicle",
    ]  # fmt: skip


def test_a_log_is_sent_to_a_link(tmp_path: Path) -> None:
    log = tmp_path / "short.tlog"
    log.write_bytes(
        b"".join((10**15 + n * 500).to_bytes(8, "big") + heartbeat(n) for n in range(10))
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(5)
        link = f"udpout:127.0.0.1:{peer.getsockname()[1]}"
        replay.main(arguments(log, QUIET, tmp_path, link=link))
        assert [peer.recv(99) for _ in range(10)] == [heartbeat(n) for n in range(10)]


def test_a_file_that_is_not_a_log_is_a_user_error(tmp_path: Path) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("no log at all" * 10)
    with pytest.raises(ConfigError, match="contains no MAVLink record; give a tlog"):
        open_log(text)
    with pytest.raises(ConfigError, match="is not a file"):
        open_log(tmp_path / "missing.tlog")
    # Random bytes that look like a record with an impossible timestamp (once an IndexError).
    text.write_bytes((1 << 63).to_bytes(8, "big") + heartbeat(1))
    with pytest.raises(ConfigError, match="contains no MAVLink record"):
        open_log(text)


def test_a_fault_of_the_plant_changes_nothing_in_a_log_and_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "a.tlog"
    log.write_bytes(b"".join((10**15 + i).to_bytes(8, "big") + sensor(i) for i in range(9)))
    plant = "faults: [{fault: plant, target: PLANT.mass_kg_add, value: 1}]"
    replay.main(arguments(log, plant, tmp_path, out=str(tmp_path / "x.tlog")))
    assert "plant on PLANT.mass_kg_add changes nothing in a log," in capsys.readouterr().err
