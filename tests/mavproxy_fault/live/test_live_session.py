"""A proxy process with all kinds of live control, and the replay of its recording."""

import contextlib
import json
import queue
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as pymavlink

from mavproxy_fault.cli import main
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import open_bus
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.signing import derive_key
from tests.signed_frames import sign_frame

PHRASE = "open sesame"
KEY = derive_key(PHRASE)
SCHEDULE = """
seed: 3
faults:
  - {id: noisy, fault: noise, target: ATTITUDE.roll, value: 0.1}
  - {id: late, fault: delay, target: ATTITUDE, value: 0.004}
  - {id: streamed, fault: bias, target: SCALED_PRESSURE.press_abs, profile: {live: {timeout_s: 2}}}
"""


def free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as place:
        place.bind(("127.0.0.1", 0))
        return int(place.getsockname()[1])


@contextlib.contextmanager
def proxy(*options: str) -> Iterator[tuple[int, int]]:
    """Start a proxy; yields the ports of its master and of its output."""
    command = [sys.executable, "-m", "mavproxy_fault.cli", "proxy", *options]
    command += ["--master", "udpin:127.0.0.1:0", "--to", "udpin:127.0.0.1:0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        words = process.stdout.readline().split()
        yield int(words[1].rsplit(":", 1)[1]), int(words[3].rsplit(":", 1)[1])
    finally:
        process.send_signal(signal.SIGINT)
        process.stdout.read()
        process.stdout.close()
        assert process.wait(30) == 0


class Vehicle:
    """Sends signed frames with increasing timestamps and receives nothing."""

    def __init__(self, port: int) -> None:
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.connect(("127.0.0.1", port))
        self.steps = 0

    def close(self) -> None:
        self.sock.close()

    def send(self, name: str, **values: object) -> None:
        self.steps += 1
        layout = message_layout(name)
        stamp = {"time_boot_ms" if "time_boot_ms" in layout.fields else "time_usec": 1000}
        stamp = {key: value + self.steps for key, value in stamp.items()}
        raw = build_frame(layout, {**stamp, **values}, seq=self.steps & 255)
        self.sock.send(sign_frame(Frame(raw, layout), KEY, 1, 10**12 + self.steps).raw)


class Station:
    """Receives the proxy's frames and checks every signature with pymavlink."""

    def __init__(self, port: int) -> None:
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.settimeout(20)
        self.sock.connect(("127.0.0.1", port))
        self._decoder = pymavlink.MAVLink(None)
        self._decoder.signing.secret_key = KEY
        self._decoder.signing.allow_unsigned_callback = lambda _, __: True

    def close(self) -> None:
        self.sock.close()

    def meet(self, vehicle: Vehicle) -> bytes:
        """Wait for the first frame, which arrives once the proxy knows this endpoint."""
        self.sock.send(
            build_frame(message_layout("HEARTBEAT"), {"type": 6}, system=255, component=190)
        )
        self.sock.settimeout(0.5)
        for _ in range(40):
            vehicle.send("SCALED_IMU", xgyro=100)
            with contextlib.suppress(TimeoutError):
                data = self.sock.recv(300)
                self.sock.settimeout(20)
                return data
        raise AssertionError("nothing passes")

    def next(self, kind: str) -> Any:
        while True:
            for message in self._decoder.parse_buffer(self.sock.recv(65_535)) or ():
                if message.get_type() == kind:
                    return message

    def command(self, *parameters: float) -> int:
        values = {f"param{n}": one for n, one in enumerate(parameters, 1)}
        values |= {"command": 420, "target_system": 1, "target_component": 1}
        self.sock.send(
            build_frame(message_layout("COMMAND_LONG"), values, system=255, component=190)
        )
        return int(self.next("COMMAND_ACK").result)


@pytest.fixture
def schedule(tmp_path: Path) -> Path:
    path = tmp_path / "faults.yaml"
    path.write_text(SCHEDULE)
    (tmp_path / "key").write_text(PHRASE)
    return path


def test_a_session_with_live_faults_replays_byte_for_byte(tmp_path: Path, schedule: Path) -> None:
    url, rflysim = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}", free_port(socket.SOCK_DGRAM)
    options = ["--schedule", str(schedule), "--logdir", str(tmp_path / "log"), "--zenoh", url]
    options += ["--rflysim", str(rflysim), "--signing-key", str(tmp_path / "key")]
    stats: queue.SimpleQueue[list[dict[str, Any]]] = queue.SimpleQueue()
    with (
        proxy(*options) as (master, out),
        open_bus(url, run="*") as bus,
        contextlib.closing(Vehicle(master)) as vehicle,
        contextlib.closing(Station(out)) as station,
    ):
        bus.subscribe("proxy/stats", lambda _, data: stats.put(json.loads(data)))
        station.meet(vehicle)
        for _ in range(20):
            vehicle.send("ATTITUDE", roll=0.5)
        assert abs(station.next("ATTITUDE").roll - 0.5) < 1.0

        vehicle.send("GLOBAL_POSITION_INT", vx=7)
        assert station.next("GLOBAL_POSITION_INT").vx == 7
        inject = ["inject", "bias", "--target", "GLOBAL_POSITION_INT.vx", "--value", "30"]
        assert main([*inject, "--zenoh", url]) == 0
        vehicle.send("GLOBAL_POSITION_INT", vx=7)
        assert station.next("GLOBAL_POSITION_INT").vx == 37
        assert main(["inject", "--clear", "bias", "--zenoh", url]) == 0

        packet = struct.pack("<10i20f", 1234567897, 1, 123450, *[123549] * 7, 0.5, *[1.0] * 19)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as simulator:
            simulator.sendto(packet, ("127.0.0.1", rflysim))
        while "rflysim-1-123450.1" not in str(bus.query("@ctl/state")[0]):
            pass  # the packet is on its way
        vehicle.send("HIL_ACTUATOR_CONTROLS", controls=[0.8] * 16)
        assert station.next("HIL_ACTUATOR_CONTROLS").controls[0] == pytest.approx(0.4)

        vehicle.send("GPS_INPUT", alt=100.0)
        assert station.next("GPS_INPUT").alt == 100.0
        assert station.command(4, 4, 0) == 0  # GPS is wrong
        vehicle.send("GPS_INPUT", alt=100.0)
        assert station.next("GPS_INPUT").alt == 300.0
        sent_us = time.time_ns() // 1000 - 1500
        value = {"value": 12.5, "sent_us": sent_us}
        bus.query("@ctl/fault/streamed/value", json.dumps(value).encode())
        vehicle.send("SCALED_PRESSURE", press_abs=900.0)
        assert station.next("SCALED_PRESSURE").press_abs == 912.5
        faults = json.loads(bus.query("@ctl/state")[0])["faults"]
        (latency_us,) = [f["latency_us"] for f in faults if f["id"] == "streamed"]
        assert 1500 <= latency_us <= time.time_ns() // 1000 - sent_us
        stale = json.dumps({"value": 99, "sent_us": sent_us - 2_500_000}).encode()
        with pytest.raises(ConfigError, match=r"values older than 2.0 s are refused"):
            bus.query("@ctl/fault/streamed/value", stale)

        found = stats.get(timeout=20)
        while found[1]["chunks_out"] < 20:
            found = stats.get(timeout=20)
    assert [point["direction"] for point in found] == ["from-vehicle", "to-vehicle"]
    assert found[0]["frames_in"] >= 20
    assert found[0]["faulted"] >= 20
    assert found[0]["p99_us"] > 0

    again = tmp_path / "again.tlog"
    words = ["replay", str(tmp_path / "log" / "received.tlog"), "--schedule", str(schedule)]
    assert main([*words, "--out", str(again), "--signing-key", str(tmp_path / "key")]) == 0
    assert again.read_bytes() == (tmp_path / "log" / "sent.tlog").read_bytes()
    labels = tmp_path / "log" / "labels.jsonl"
    assert again.with_suffix(".labels.jsonl").read_bytes() == labels.read_bytes()
    ids = {label.id for label in read_labels(labels)}
    assert {"noisy", "late", "bias", "streamed", "rflysim-1-123450.1"} <= ids
    assert any(id.startswith("mav-gps") for id in ids)


def test_signatures_are_stripped_on_request() -> None:
    with (
        proxy("--zenoh", "off", "--strip-signatures") as (master, out),
        contextlib.closing(Vehicle(master)) as vehicle,
        contextlib.closing(Station(out)) as station,
    ):
        data = station.meet(vehicle)
        assert data[2] == 0
        assert pymavlink.MAVLink(None).decode(bytearray(data)).xgyro == 100
