"""Live control of a proxy process by real clients."""

import contextlib
import signal
import socket
import subprocess
import sys
from math import nan
from pathlib import Path
from typing import Any

from pymavlink import mavutil

from mavproxy_fault.cli import main
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame


def meet(vehicle: socket.socket, proxy: tuple[str, int], station: Any) -> None:
    """Send heartbeats until the proxy knows both endpoints and forwards them."""
    vehicle.settimeout(1)
    for _ in range(30):
        vehicle.sendto(build_frame(message_layout("HEARTBEAT"), {"type": 2}), proxy)
        station.mav.heartbeat_send(6, 8, 0, 0, 4)
        with contextlib.suppress(TimeoutError):
            vehicle.recv(300)
            return
    raise AssertionError("the proxy passed no heartbeat on")


def test_a_ground_station_injects_a_failure_through_a_running_proxy(tmp_path: Path) -> None:
    schedule = tmp_path / "quiet.yaml"
    schedule.write_text("seed: 1\n")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        command = [
            sys.executable,
            "-m",
            "mavproxy_fault.cli",
            "proxy",
            "--zenoh",
            "tcp/127.0.0.1:0",
        ]
        command += ["--schedule", str(schedule), "--master", "udpin:127.0.0.1:0"]
        command += ["--to", "udpin:127.0.0.1:0"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        words = process.stdout.readline().split()
        master, out = (int(words[i].rsplit(":", 1)[1]) for i in (1, 3))
        station = mavutil.mavlink_connection(f"udpout:127.0.0.1:{out}", source_system=255)
        try:
            layout = message_layout("HIL_SENSOR")
            values = {"time_usec": 1_000_000, "xgyro": 0.1, "fields_updated": 63}
            healthy = build_frame(layout, values)
            meet(vehicle, ("127.0.0.1", master), station)
            vehicle.sendto(healthy, ("127.0.0.1", master))
            assert station.recv_match(type="HIL_SENSOR", blocking=True, timeout=30).xgyro < 0.2
            station.mav.command_long_send(1, 1, 420, 0, 0, 4, 0, nan, nan, nan, nan)
            ack = station.recv_match(type="COMMAND_ACK", blocking=True, timeout=30)
            assert (ack.command, ack.result, ack.get_srcSystem()) == (420, 0, 1)
            vehicle.sendto(healthy, ("127.0.0.1", master))
            assert station.recv_match(type="HIL_SENSOR", blocking=True, timeout=30).xgyro > 0.5
            said = station.recv_match(type="STATUSTEXT", blocking=True, timeout=30)
            assert said.get_srcComponent() == 191
        finally:
            station.close()
            process.send_signal(signal.SIGINT)
            process.stdout.read()
            process.stdout.close()
            assert process.wait(30) == 0


def test_a_proxy_without_a_schedule_accepts_live_faults() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    command = [sys.executable, "-m", "mavproxy_fault.cli", "proxy", "--zenoh", url]
    command += ["--master", "udpin:127.0.0.1:0", "--to", "udpin:127.0.0.1:0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        assert process.stdout.readline().startswith("ready: ")
        assert main(["inject", "baro-freeze", "--zenoh", url]) == 0
        assert main(["inject", "--clear", "baro-freeze", "--zenoh", url]) == 0
    finally:
        process.send_signal(signal.SIGINT)
        process.stdout.read()
        process.stdout.close()
        assert process.wait(30) == 0
