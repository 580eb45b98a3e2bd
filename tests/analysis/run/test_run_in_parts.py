"""`sim`, `proxy` and `monitor` as three processes, compared with `run` as one."""

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import yaml

from analysis.results import Decision, read_results
from mavproxy_fault.wire.label import read_labels

SHORT = Path(__file__).with_name("short.yaml")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def started(ready: str, *arguments: str | Path) -> Iterator["subprocess.Popen[str]"]:
    """Start a process and wait until it reports that it is ready."""
    command = [sys.executable, "-m", "mavproxy_fault.cli", *map(str, arguments)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            assert process.stdout is not None
            for line in process.stdout:
                if line.startswith(ready):
                    break
            yield process
        finally:
            process.terminate()
            process.communicate(timeout=20)


def decisions(folder: Path) -> list[Decision]:
    return [r for r in read_results(folder / "results.jsonl") if isinstance(r, Decision)]


def test_three_processes_give_the_same_decisions_as_one(tmp_path: Path) -> None:
    schedule = tmp_path / "schedule.yaml"
    section = yaml.safe_load(SHORT.read_text())["schedule"]
    schedule.write_text(yaml.safe_dump({"seed": 7, **section}))
    to_proxy, to_monitor = free_port(), free_port()
    ours = (sys.executable, "-m", "mavproxy_fault.cli")
    with ExitStack() as stack:
        monitor = stack.enter_context(
            started(
                "monitoring", "monitor", "--link", f"udpin:127.0.0.1:{to_monitor}",
                "--scenario", SHORT, "--for", "7.9", "--out", tmp_path / "parts", "--zenoh", "off",
            )
        )  # fmt: skip
        stack.enter_context(
            started(
                "ready", "proxy", "--master", f"udpout:127.0.0.1:{to_monitor}",
                "--to", f"udpin:127.0.0.1:{to_proxy}", "--schedule", schedule,
                "--logdir", tmp_path / "log", "--zenoh", "off",
            )
        )  # fmt: skip
        sim = [*ours, "sim", str(SHORT), "--hil", f"udpout:127.0.0.1:{to_proxy}", "--speed", "4"]
        subprocess.run(sim, check=True, capture_output=True, timeout=100)
        assert monitor.wait(timeout=60) == 0

    run = [*ours, "run", str(SHORT), "--out", str(tmp_path / "run"), "--zenoh", "off"]
    subprocess.run(run, check=True, capture_output=True, timeout=100)
    parts, whole = decisions(tmp_path / "parts"), decisions(tmp_path / "run")
    assert len(parts) >= 39
    assert parts == whole[: len(parts)]
    (ours_label,) = read_labels(tmp_path / "log" / "labels.jsonl")
    (whole_label,) = read_labels(tmp_path / "run" / "labels.jsonl")
    assert ours_label == whole_label
