import argparse
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mavproxy_fault.app import commands
from mavproxy_fault.app import proxy_command as proxy
from mavproxy_fault.app import server as server_module
from mavproxy_fault.app.recorder import Recorder
from mavproxy_fault.app.replaying.playback import split_records
from mavproxy_fault.compiled import object_file as machine
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links import udp as udp_links
from mavproxy_fault.links.bus import open_bus
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.links.tcp import TcpServer
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from tests.mavproxy_fault.serving import serving


def heartbeat(seq: int = 0, system: int = 1, component: int = 1) -> bytes:
    return build_frame(
        message_layout("HEARTBEAT"), {"type": 2}, seq=seq, system=system, component=component
    )


def sensor(step: int) -> bytes:
    values = {"time_usec": 1_000_000 + step * 4000, "fields_updated": 63}
    return build_frame(message_layout("HIL_SENSOR"), values, seq=step & 255, component=51)


@contextlib.contextmanager
def udp() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(10)
        yield sock


def address(link: Link) -> tuple[str, int]:
    return "127.0.0.1", int(link.name.rsplit(":", 1)[1])


def sending_to(sock: socket.socket) -> Link:
    return open_link(f"udpout:127.0.0.1:{sock.getsockname()[1]}")


def test_without_memory_forwarding_continues_and_lost_records_are_counted(
    tmp_path: Path,
) -> None:
    class Short(CaptureBuffer):
        """A capture buffer that runs out of memory at first."""

        left = 3

        def receive(self, *given: Any, **more: Any) -> None:
            if self.left:
                self.left -= 1
                raise MemoryError
            super().receive(*given, **more)

    tape, recorder = Short(), Recorder(tmp_path, {})
    with udp() as station, udp() as vehicle:
        links = [open_link("udpin:127.0.0.1:0"), sending_to(station)]
        with serving(links, tape=tape, recorder=recorder) as running:
            for seq in range(10):
                vehicle.sendto(heartbeat(seq), address(links[0]))
            came = [station.recv(999) for _ in range(7)]
    assert came == [heartbeat(seq) for seq in range(3, 10)]
    assert running.memory_shortages == 3
    recorded = [raw for _, raw in split_records((tmp_path / "received.tlog").read_bytes())]
    assert came[-len(recorded) :] == recorded
    assert recorder.lost == 7 - len(recorded)


def test_a_tcp_peer_that_does_not_read_blocks_no_other() -> None:
    master, slow = open_link("udpin:127.0.0.1:0"), open_link("tcpin:127.0.0.1:0")
    with udp() as station, udp() as vehicle:
        links = [master, slow, sending_to(station)]
        with serving(links), socket.create_connection(address(slow), timeout=10) as peer:
            peer.sendall(heartbeat(system=200))
            station.recv(999)
            filler = b"\0" * 30_000
            while not slow.counters.drops:
                vehicle.sendto(filler, address(master))
                assert station.recv(65535) == filler
            vehicle.sendto(heartbeat(7), address(master))
            assert station.recv(999) == heartbeat(7)


def test_a_tcp_endpoint_that_comes_back_is_served_again() -> None:
    master = open_link("udpin:127.0.0.1:0")
    with udp() as vehicle, socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(10)
        port = listener.getsockname()[1]
        with serving([master, open_link(f"tcp:127.0.0.1:{port}")]):
            for seq in range(3):
                peer, _ = listener.accept()
                peer.settimeout(10)
                vehicle.sendto(heartbeat(seq), address(master))
                assert peer.recv(999) == heartbeat(seq)
                peer.sendall(heartbeat(seq, system=255) + heartbeat(seq, system=254)[:5])
                assert vehicle.recv(999) == heartbeat(seq, system=255)
                peer.close()
                assert vehicle.recv(999) == heartbeat(seq, system=254)[:5]


def test_two_vehicles_and_two_stations_share_one_proxy() -> None:
    master = open_link("udpin:127.0.0.1:0")
    with udp() as one, udp() as two, udp() as station, udp() as other:
        links = [master, sending_to(station), sending_to(other)]
        with serving(links):
            one.sendto(heartbeat(0, 1), address(master))
            two.sendto(heartbeat(0, 2), address(master))
            for sock in (station, other):
                assert {sock.recv(999), sock.recv(999)} == {heartbeat(0, 1), heartbeat(0, 2)}
            other.sendto(heartbeat(0, 254), links[2].sock.getsockname())  # type: ignore[attr-defined]
            assert station.recv(999) == heartbeat(0, 254)
            values = {"target_system": 254, "target_component": 1, "command": 400}
            answer = build_frame(message_layout("COMMAND_ACK"), values, system=2)
            two.sendto(answer, address(master))
            two.sendto(heartbeat(1, 2), address(master))
            assert station.recv(999) == heartbeat(1, 2), "the answer was for the other one"
            assert other.recv(999) == answer


@pytest.mark.parametrize("turn", ["_step", "_run_due"])
def test_a_delayed_proxy_still_joins_the_parts_of_a_frame(
    turn: str,
) -> None:
    master, outlet = TcpServer("127.0.0.1", 0), TcpServer("127.0.0.1", 0)
    running = server_module.Server([master, outlet], Core(proxy.link_roles([master, outlet])))
    with socket.create_connection(address(master)) as vehicle:
        vehicle.sendall(sensor(0)[:30])
        while not running.core._resync_deadlines:
            running._step()
        vehicle.sendall(sensor(0)[30:])
        running._base_ns += 2 * 10**9  # the process was not scheduled for this long
        getattr(running, turn)()
    assert (running.core.states[0].frames, running.core.states[0].junk) == (1, 0)
    master.close()
    outlet.close()


def test_a_delayed_frame_is_sent_without_further_traffic() -> None:
    schedule = "faults: [{id: d, fault: delay, target: HIL_SENSOR, value: 0.02}]"
    master = open_link("udpin:127.0.0.1:0")
    with udp() as station, udp() as vehicle:
        links = [master, sending_to(station)]
        with serving(links, Engine(parse_schedule(schedule))) as running:
            vehicle.sendto(sensor(0), address(master))
            assert b"FAULT d on" in station.recv(999)
            assert station.recv(999) == sensor(0)
        assert running.stats()[0]["faulted"] == 1


def test_counters_are_per_endpoint() -> None:
    master = open_link("udpin:127.0.0.1:0")
    with udp() as station, udp() as vehicle:
        with serving([master, sending_to(station)]) as running:
            for seq in (0, 1, 4):
                vehicle.sendto(heartbeat(seq) + b"noise", address(master))
                station.recv(999)
        first, second = running.stats()
    assert (first["frames_in"], first["junk_in"], first["gaps"], first["peers"]) == (3, 3, 2, 1)
    assert (second["chunks_out"], second["frames_in"]) == (3, 0)
    assert first["p50_us"] > 0
    assert second["p50_us"] is None


def test_the_process_stops_cleanly_and_prints_its_counters(tmp_path: Path) -> None:
    with udp() as station, udp() as vehicle:
        command = [sys.executable, "-m", "mavproxy_fault.cli", "proxy", "--zenoh", "off"]
        command += ["--master", "udpin:127.0.0.1:0", "--logdir", str(tmp_path)]
        command += ["--out", f"127.0.0.1:{station.getsockname()[1]}"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        ready = process.stdout.readline()
        assert ready.startswith("ready: udpin:127.0.0.1:")
        vehicle.sendto(heartbeat(), ("127.0.0.1", int(ready.split()[1].rsplit(":", 1)[1])))
        assert station.recv(999) == heartbeat()
        process.send_signal(signal.SIGINT)
        lines = process.stdout.read().splitlines()
        assert process.wait(10) == 0
        process.stdout.close()
    assert lines[0].split()[:3] == ["endpoint", "peers", "in"]
    assert lines[1].split()[1:3] == ["1", "1"]
    assert (tmp_path / "sent.tlog").read_bytes()[8:] == heartbeat()
    assert json.loads((tmp_path / "session.json").read_text())["end_us"] > 10**15


def test_the_final_counters_include_datagrams_dropped_by_the_kernel() -> None:
    with udp() as station, udp() as vehicle:
        command = [sys.executable, "-m", "mavproxy_fault.cli", "proxy", "--zenoh", "off"]
        command += ["--master", "udpin:127.0.0.1:0"]
        command += ["--out", f"127.0.0.1:{station.getsockname()[1]}"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            port = int(process.stdout.readline().split()[1].rsplit(":", 1)[1])
            process.send_signal(signal.SIGSTOP)
            for _ in range(2000):  # more than its buffer can hold
                vehicle.sendto(bytes(60_000), ("127.0.0.1", port))
            process.send_signal(signal.SIGCONT)
            process.send_signal(signal.SIGINT)
            names, row, *_ = process.stdout.read().replace("bytes ", "bytes-").splitlines()
    lost = dict(zip(names.split(), row.split(), strict=False))["lost"]
    assert 0 < int(lost) < 2000


def test_a_proxy_without_faults_does_not_import_fault_modules() -> None:
    code = (
        "import mavproxy_fault.app.proxy_command, sys\n"
        "print({'numpy', 'yaml', 'msgspec'} & {*sys.modules})"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True)
    assert said.stdout == "set()\n"


def test_a_wrong_output_leaves_no_socket_behind() -> None:
    before = len(os.listdir("/proc/self/fd"))
    parser = argparse.ArgumentParser()
    commands.add_proxy(parser.add_subparsers())
    args = parser.parse_args(["proxy", "--master", "udpin:127.0.0.1:0", "--out", "nonsense"])
    with pytest.raises(ConfigError, match="nonsense: is not a connection string"):
        proxy.main(args)
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_running_proxy_accepts_faults_over_zenoh_and_acknowledges_failures() -> None:
    with udp() as station, udp() as vehicle, socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        url = f"tcp/127.0.0.1:{place.getsockname()[1]}"
        place.close()
        command = [sys.executable, "-m", "mavproxy_fault.cli", "proxy", "--zenoh", url]
        command += ["--master", "udpin:127.0.0.1:0"]
        command += ["--out", f"127.0.0.1:{station.getsockname()[1]}"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        try:
            port = int(process.stdout.readline().split()[1].rsplit(":", 1)[1])
            vehicle.sendto(sensor(0), ("127.0.0.1", port))
            data, address = station.recvfrom(999)
            assert data == sensor(0)
            with open_bus(url) as bus:
                entry = b'{"fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 0.5}'
                bus.query("@ctl/fault/step/arm", entry)
                vehicle.sendto(sensor(1), ("127.0.0.1", port))
                (frame,) = Parser().push(station.recv(999), datagram=True)
                assert isinstance(frame, Frame)
                assert frame.number("xgyro") == 0.5
                assert b"FAULT step on" in station.recv(999)
            vehicle.sendto(build_frame(message_layout("HEARTBEAT"), {}), ("127.0.0.1", port))
            station.recv(999)
            values = {"target_system": 1, "target_component": 1, "command": 420, "param2": 1}
            request = build_frame(message_layout("COMMAND_LONG"), values, system=255, component=190)
            station.sendto(request, address)
            (answer,) = Parser().push(station.recv(999), datagram=True)
            assert isinstance(answer, Frame)
            assert (answer.layout.name, answer.number("command")) == ("COMMAND_ACK", 420)
            assert answer.number("result") == 0
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=10)
    assert process.returncode == 0


def test_without_compiled_kernels_the_proxy_warns_and_forwards(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(machine, "load", lambda: None)
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with udp() as station:
        links = [
            open_link("udpin:127.0.0.1:0"),
            open_link(f"udpout:127.0.0.1:{station.getsockname()[1]}"),
        ]
        with serving(links) as running, udp() as vehicle:
            running.prepare()
            running._compiler.wait(10)
            vehicle.sendto(heartbeat(), ("127.0.0.1", links[0].port))
            assert station.recv(1000) == heartbeat()
            while running._compiler is not None:
                vehicle.sendto(heartbeat(), ("127.0.0.1", links[0].port))
                station.recv(1000)
    assert "compiling kernels" in caplog.text
    assert "compiling kernels failed" in caplog.text


def test_a_proxy_that_cannot_start_a_thread_runs_without_live_control(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class NoThread:
        def __init__(self, target: object) -> None:
            pass

        def start(self) -> None:
            raise RuntimeError("can't start new thread")  # as Python does with a low `ulimit -u`

    monkeypatch.setattr(proxy, "Thread", NoThread)
    server = server_module.Server([], Core([]))
    proxy.start_live(argparse.Namespace(), None, server)
    server._run_due()
    assert server.live is None
    assert (
        "no live control, forwarding continues: RuntimeError: can't start new thread" in caplog.text
    )


def test_a_proxy_with_a_schedule_is_ready_without_numpy() -> None:
    schedule = Path(__file__).parents[3] / "examples" / "gyro_bias.yaml"
    script = (
        "import sys, mavproxy_fault.app.proxy_command, mavproxy_fault.compiled.forwarder\n"
        "from mavproxy_fault.proxy.engine import Engine\n"
        "from mavproxy_fault.schedule.entries import read_schedule\n"
        f"Engine(read_schedule({str(schedule)!r}))\n"
        "print('numpy' in sys.modules, 'numba' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    assert done.stdout.split() == [b"False", b"False"]


# Every fault without random numbers, on one second of its messages.
FAULTS_THAT_DRAW_NOTHING = """
import json, sys
from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.proxy.core import Core, LinkRole
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

tried, compiled = [], set()
for name, kind in known_faults().items():
    entry = {"id": name, "fault": name, **(getattr(kind, "example", None) or {})}
    engine = Engine(parse_schedule(json.dumps({"seed": 1, "faults": [entry]})))
    if engine.draws:
        continue
    tape = CaptureBuffer()
    core = Core([LinkRole("a", "to-vehicle"), LinkRole("b", "from-vehicle")], engine, tape=tape)
    machine, left, take = CompiledCore(core, 0, tape), [], core._process
    core._process = lambda *args: left.append(1) or take(*args)
    for n in range(100):
        values = {"time_usec": 1_000_000 + 10_000 * n, "fields_updated": 63}
        frame = build_frame(message_layout("HIL_SENSOR"), values, seq=n, system=1, component=1)
        machine.received(0, frame, 10_000 * n)
    if len(left) < 10:
        compiled.add(name)
    state = engine.state()["faults"][0]
    assert not state.get("failure"), state
    tried.append(name)
print(len(tried), len(compiled), "numpy" in sys.modules)
"""


def test_a_fault_without_random_numbers_never_imports_numpy() -> None:
    machine.make()
    done = subprocess.run([sys.executable, "-c", FAULTS_THAT_DRAW_NOTHING], capture_output=True)
    assert done.returncode == 0, done.stderr
    count, compiled, has_numpy = done.stdout.split()
    assert int(count) > 15
    assert int(compiled) > 12
    assert has_numpy == b"False"


def test_without_linux_system_calls_the_interpreted_path_is_used(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(udp_links, "IS_LINUX", False)
    monkeypatch.setattr(server_module.ctypes, "CDLL", lambda name: object())
    master = open_link("udpin:127.0.0.1:0")
    with udp() as station, udp() as vehicle:
        links = [master, sending_to(station)]
        with serving(links) as running:
            running.prepare()
            assert running._forwarder is None
            assert running._compiler is None
            for seq in range(100):
                vehicle.sendto(heartbeat(seq), address(master))
                assert station.recv(999) == heartbeat(seq)
            station.sendto(heartbeat(system=255), links[1].sock.getsockname())  # type: ignore[attr-defined]
            assert vehicle.recv(999) == heartbeat(system=255)
        assert running.stats()[0]["chunks_in"] == 100
