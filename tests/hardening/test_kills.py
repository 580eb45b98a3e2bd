"""A proxy and a run that are killed leave recordings that can be read, up to the last second.

`KILLS=100 pytest -s tests/hardening/test_kills.py` is the long form; it prints what was lost.
"""

import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from analysis.results import read_results
from mavproxy_fault.wire.dialect import known
from mavproxy_fault.wire.frame import build
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.tlog import read_records

KILLS = int(os.environ.get("KILLS", "2"))
OURS = [sys.executable, "-m", "mavproxy_fault.cli"]
SCHEDULE = """
seed: 1
faults:
  - {id: on, fault: bias, target: ATTITUDE.roll, value: 0.1}
"""


def numbered(number: int) -> bytes:
    """A frame that tells its number, with a stamp that starts the schedule."""
    values = {"time_boot_ms": number, "yaw": float(number)}
    return build(known("ATTITUDE"), values, seq=number & 255)


def number_of(frame: bytes) -> int:
    return int.from_bytes(frame[10:14], "little")  # time_boot_ms, the first field of the payload


@pytest.mark.parametrize("kill", range(KILLS))
def test_a_killed_proxy_leaves_all_but_the_last_second(kill: int, tmp_path: Path) -> None:
    (tmp_path / "one.yaml").write_text(SCHEDULE)
    logs = tmp_path / "logs"
    further = random.Random(kill).randrange(1, 5000)
    sent_at_s: list[float] = []
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
    ):
        station.bind(("127.0.0.1", 0))
        station.settimeout(60)
        command = [*OURS, "proxy", "--zenoh", "off", "--schedule", str(tmp_path / "one.yaml")]
        command += ["--logdir", str(logs), "--master", "udpin:127.0.0.1:0"]
        command += ["--to", f"udpout:127.0.0.1:{station.getsockname()[1]}"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            port = int(process.stdout.readline().split()[1].rsplit(":", 1)[1])
            vehicle.connect(("127.0.0.1", port))
            written = 0  # frames when the first second was on the disk
            while not written or len(sent_at_s) < written + further:
                vehicle.send(numbered(len(sent_at_s) + 1))
                sent_at_s.append(time.monotonic())
                while b"\xfd" not in station.recv(300)[:1]:
                    pass
                if not written and (logs / "sent.tlog").stat().st_size:
                    written = len(sent_at_s)
            process.kill()
            killed_s = time.monotonic()
    for name in ("received.tlog", "sent.tlog"):
        frames = [
            number_of(raw) for _, raw, _ in read_records(logs / name) if raw[7:10] == b"\x1e\0\0"
        ]
        assert frames == list(range(1, len(frames) + 1))
        assert len(frames) >= written // 2
    assert [label.id for label in read_labels(logs / "labels.jsonl")] == ["on"]
    assert json.loads((logs / "session.json").read_text())["seed"] == 1
    lost_s = killed_s - sent_at_s[len(frames)] if len(frames) < len(sent_at_s) else 0.0
    print(f"proxy {kill}: {len(frames)} of {len(sent_at_s)} recorded, {lost_s:.2f} s lost")


@pytest.mark.parametrize("kill", range(KILLS))
def test_a_killed_run_leaves_logs_and_results_that_can_be_read(kill: int, tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [*OURS, "run", "--zenoh", "off", "--gcs", "off", "--speed", "20", "--out", str(out)]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    ) as process:
        enough = random.Random(kill).randrange(1, 1_000_000)
        while process.poll() is None and size(out / "received.tlog") < enough:
            os.sched_yield()
        assert process.poll() is None
        os.killpg(process.pid, signal.SIGKILL)  # its monitor too
    received, sent = (list(read_records(out / f"{name}.tlog")) for name in ("received", "sent"))
    assert received
    for records in (received, sent):
        stamps = [t_us for t_us, _, _ in records]
        assert stamps == sorted(stamps)
    results = len(list(read_results(out / "results.jsonl")))
    labels = read_labels(out / "labels.jsonl") if (out / "labels.jsonl").exists() else []
    print(f"run {kill}: {len(received)} frames, {len(labels)} labels, {results} results")


def size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0
