"""MAVSDK injects failures into a vehicle behind a proxy process, which applies them."""

import contextlib
import json
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk, log_subscribe
from mavsdk.plugins.failure import Failure, FailureError, FailureType, FailureUnit
from pymavlink import mavutil

ENABLED = struct.unpack("<f", struct.pack("<i", 1))[0]  # PX4 sends integers bytewise


def fly(vehicle: mavutil.mavudp, stop: threading.Event) -> None:
    """A minimal PX4: heartbeats, its simulator's IMU, SYS_FAILURE_EN, and refusals."""
    step = 0
    while not stop.wait(0.02):
        step += 1
        vehicle.mav.heartbeat_send(2, 12, 0, 4 << 16, 4)
        imu = [0, 0, -9.8, 0.1, 0, 0, 0.2, 0, 0.4, 950, 0, 500, 20]
        vehicle.mav.hil_sensor_send(20_000 * step, *imu, 0x1FFF, 0)
        heard = vehicle.recv_match(type=["PARAM_REQUEST_READ", "COMMAND_LONG"], blocking=False)
        if heard is None:
            continue
        if heard.get_type() == "COMMAND_LONG":
            if heard.command == 420:
                vehicle.mav.command_ack_send(420, 3, 0, 0, heard.get_srcSystem(), 190)
        elif heard.param_id == "SYS_FAILURE_EN":
            vehicle.mav.param_value_send(b"SYS_FAILURE_EN", ENABLED, 6, 1, 0)


@contextlib.contextmanager
def proxy(folder: Path, out: int, *options: str) -> Iterator[int]:
    """Start a proxy process that sends to a port; yields the vehicle's port."""
    command = [sys.executable, "-m", "mavproxy_fault.cli", "proxy", "--logdir", str(folder)]
    command += ["--zenoh", "tcp/127.0.0.1:0", "--master", "udpin:127.0.0.1:0"]
    command += ["--to", f"udpout:127.0.0.1:{out}", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield int(process.stdout.readline().split()[1].rsplit(":", 1)[1])
    finally:
        process.send_signal(signal.SIGINT)
        process.stdout.read()
        process.stdout.close()
        assert process.wait(30) == 0


@contextlib.contextmanager
def flying(port: int) -> Iterator[None]:
    """Run the vehicle in a thread."""
    vehicle = mavutil.mavlink_connection(
        f"udpout:127.0.0.1:{port}", source_system=1, source_component=1
    )
    stop = threading.Event()
    flight = threading.Thread(target=fly, args=(vehicle, stop))
    flight.start()
    try:
        yield
    finally:
        stop.set()
        flight.join()
        vehicle.close()


def free_port() -> int:
    """Return a UDP port that MAVSDK may bind."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@contextlib.contextmanager
def flown(folder: Path, *options: str) -> Iterator[Failure]:
    """Connect MAVSDK's failure plugin through a proxy."""
    port = free_port()
    log_subscribe(lambda *_: True)
    station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    with proxy(folder, port, *options) as master, flying(master), Mavsdk(station) as mavsdk:
        mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = mavsdk.first_autopilot(30.0)
        assert system is not None
        yield Failure(system)


def test_mavsdk_injects_failures_and_they_are_labelled(tmp_path: Path) -> None:
    with flown(tmp_path) as failure:
        end_s = time.monotonic() + 30
        for unit, kind, number in (
            (FailureUnit.SENSOR_GYRO, FailureType.WRONG, 0),
            (FailureUnit.SENSOR_MAG, FailureType.SLOW, 1),
        ):
            while True:
                try:
                    failure.inject(unit, kind, number)
                    break
                except FailureError:  # before the first HIL_SENSOR the vehicle answers
                    assert time.monotonic() < end_s
        written = tmp_path / "labels.jsonl"
        while "mav-gyro.1" not in written.read_text():  # it must have changed a frame first
            assert time.monotonic() < end_s
            with pytest.raises(FailureError, match=r"(?i)unsupported"):
                failure.inject(FailureUnit.SYSTEM_BATTERY, FailureType.OFF, 0)
        failure.inject(FailureUnit.SENSOR_GYRO, FailureType.OK, 0)
    labels = [json.loads(line) for line in (tmp_path / "labels.jsonl").read_text().splitlines()]
    assert {label["id"] for label in labels} >= {"mav-gyro.1"}
    assert all(label["frames"] > 0 for label in labels)


def test_the_vehicle_answers_mavsdk_when_live_faults_are_refused(tmp_path: Path) -> None:
    with (
        flown(tmp_path, "--no-inject") as failure,
        pytest.raises(FailureError, match=r"(?i)unsupported"),
    ):
        failure.inject(FailureUnit.SENSOR_GYRO, FailureType.WRONG, 0)


def injected(port: int, failure: str, *options: str) -> subprocess.CompletedProcess[str]:
    """Run the command that sends a failure by MAVSDK."""
    command = [sys.executable, "-m", "mavproxy_fault.cli", "inject", failure, *options]
    command += ["--through", "mavsdk", "--link", f"udpin://127.0.0.1:{port}"]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_command_line_sends_a_failure_and_ends_it(tmp_path: Path) -> None:
    port = free_port()
    with proxy(tmp_path, port) as master, flying(master):
        done = injected(port, "gyro:wrong", "--for", "0.3")
        assert (done.returncode, done.stdout) == (0, "gyro:wrong: accepted\ngyro:wrong: ended\n")
        refused = injected(port, "battery:off")
        assert refused.returncode == 1
        assert refused.stderr == "battery:off: the vehicle does not support this failure\n"
    labels = [json.loads(line) for line in (tmp_path / "labels.jsonl").read_text().splitlines()]
    assert labels[-1]["id"] == "mav-gyro.1"
    assert labels[-1]["end_us"] is not None


@pytest.mark.parametrize(
    ("failure", "reason"),
    [
        ("gps:of", "gps:of has no type; give UNIT:TYPE[:INSTANCE], such as gps:off, with ok, off"),
        ("gyros:off", "'gyros' is not a failure unit; did you mean gyro"),
        ("gps:off:first", "instance first is not a number; give 0 for all"),
    ],
)
def test_an_unknown_failure_is_refused_before_anything_is_sent(failure: str, reason: str) -> None:
    done = injected(0, failure)
    assert done.returncode == 2
    assert reason in done.stderr
