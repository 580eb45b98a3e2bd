"""A killed proxy or run leaves readable recordings that lack at most the last second.

`KILLS=100 pytest -s tests/hardening/test_kills.py` is the long form; it prints the losses.
"""

import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from analysis.results import read_results
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.tlog import read_records

KILLS = int(os.environ.get("KILLS", "2"))
COMMAND = [sys.executable, "-m", "mavproxy_fault.cli"]
SCHEDULE = """
seed: 1
faults:
  - {id: on, fault: bias, target: ATTITUDE.roll, value: 0.1}
"""


def numbered(number: int) -> bytes:
    """A frame that contains its number, with a timestamp that starts the schedule."""
    values = {"time_boot_ms": number, "yaw": float(number)}
    return build_frame(message_layout("ATTITUDE"), values, seq=number & 255)


def number_of(frame: bytes) -> int:
    return int.from_bytes(frame[10:14], "little")  # time_boot_ms, the first field of the payload


@pytest.mark.parametrize("kill", range(KILLS))
def test_a_killed_proxy_loses_at_most_the_last_second(kill: int, tmp_path: Path) -> None:
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
        command = [*COMMAND, "proxy", "--zenoh", "off", "--schedule", str(tmp_path / "one.yaml")]
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


WRITTEN = ("received.tlog", "sent.tlog", "labels.jsonl", "results.jsonl")


def start(out: Path) -> "subprocess.Popen[bytes]":
    """A part of the demo without a bus, at twenty times real time."""
    command = [*COMMAND, "run", "--zenoh", "off", "--gcs", "off", "--speed", "20"]
    command += ["--set", "duration_s=12", "--out", str(out)]
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdout=quiet, stderr=quiet, start_new_session=True)


@pytest.fixture(scope="module")
def complete(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that is not killed."""
    out = tmp_path_factory.mktemp("complete") / "out"
    assert start(out).wait() in (0, 1)  # the demo's faults come later
    return out


# The file to wait for, and the share of a complete run's bytes that it must have.
MOMENTS = [
    ("received.tlog", 1.0), ("results.jsonl", 1.0), ("summary.json.new", 0.0),
    ("report.html.new", 0.0), ("summary.json", 0.0),
]  # fmt: skip


@pytest.mark.parametrize("kill", range(KILLS))
def test_a_killed_run_leaves_readable_logs_and_results(
    kill: int, complete: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    rng = random.Random(kill)
    name, share = MOMENTS[-1 - kill % len(MOMENTS)]
    enough = share * rng.random() * size(complete / name) if share else 0
    with start(out) as process:
        ended = None
        while ended is None and not ((out / name).exists() and size(out / name) > enough):
            with suppress(subprocess.TimeoutExpired):
                ended = process.wait(0.001)
        now_s = time.time()
        ages_s = [now_s - (out / one).stat().st_mtime for one in ("sent.tlog", "results.jsonl")]
        if ended is None:
            os.killpg(process.pid, signal.SIGKILL)  # its monitor too
    # A short-lived file may be missed: then the run ended by itself.
    assert ended in (None, 0, 1)
    for one in WRITTEN:
        if (out / one).exists():
            assert (complete / one).read_bytes().startswith((out / one).read_bytes()), one
    received, sent = (list(read_records(out / f"{one}.tlog")) for one in ("received", "sent"))
    results = list(read_results(out / "results.jsonl"))
    assert received
    assert not (out / "summary.json").exists() or "verdict" in json.loads(
        (out / "summary.json").read_text()
    )
    if (out / "report.html").exists():
        assert (out / "report.html").read_text().rstrip().endswith("</html>")
    print(
        f"run {kill}, {name}: {len(received)} frames, {len(sent)} sent, {len(results)} results, "
        f"written {ages_s[0]:.2f} and {ages_s[1]:.2f} s before"
    )


def size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # not yet, or moved meanwhile
        return 0
