"""`mavproxy-fault run` as a user runs it."""

import json
import queue
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from analysis.results import Decision, decode, read_results
from mavproxy_fault import cli
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import Bus, open_bus
from mavproxy_fault.wire.label import read_labels

SHORT = Path(__file__).with_name("short.yaml")


def mavproxy_fault(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mavproxy_fault.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    folder = tmp_path_factory.mktemp("run") / "out"
    return folder, mavproxy_fault("run", SHORT, "--out", folder, "--zenoh", "off")


Run = tuple[Path, subprocess.CompletedProcess[str]]


def summary(run: Run) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((run[0] / "summary.json").read_text())
    return found


def test_a_run_whose_criteria_hold_ends_with_0(run: Run) -> None:
    assert run[1].returncode == 0, run[1].stderr
    assert summary(run)["verdict"] == "PASS"


def test_the_faulty_satellite_is_isolated_and_nothing_else(run: Run) -> None:
    (fault,) = summary(run)["faults"]
    assert (fault["id"], fault["isolated"], fault["verdict"]) == ("step", ["G12"], "isolated")
    assert fault["delay_s"] <= 0.4
    assert summary(run)["false_alarms"] == 0


def test_the_summary_has_attitude_per_axis_and_the_position_error(run: Run) -> None:
    found = summary(run)
    assert set(found["attitude_rmse_deg"]) >= {"roll", "pitch", "yaw", "max"}
    assert found["attitude_rmse_deg"]["max"] < 5.0
    assert found["position_rmse_m"] < 3.0
    assert found["epochs"] == 40


@pytest.mark.parametrize("log", ["received.tlog", "sent.tlog"])
def test_pymavlink_reads_the_logs_without_a_bad_frame(run: Run, log: str) -> None:
    reader = mavutil.mavlink_connection(str(run[0] / log), dialect="all")
    kinds = set()
    while (message := reader.recv_match()) is not None:
        kinds.add(message.get_type())
    reader.close()
    assert "BAD_DATA" not in kinds
    assert kinds >= {"HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION", "TUNNEL", "ATTITUDE"}


def test_the_label_describes_the_injected_fault(run: Run) -> None:
    (label,) = read_labels(run[0] / "labels.jsonl")
    assert label.targets == ("PSEUDORANGE.G12",)
    assert label.magnitude == pytest.approx(50.0, abs=0.01)
    assert label.end_us is not None


def test_the_results_have_a_decision_per_epoch(run: Run) -> None:
    decisions = [r for r in read_results(run[0] / "results.jsonl") if isinstance(r, Decision)]
    assert len(decisions) == 40
    times = [decision.t_s for decision in decisions]
    assert times == sorted(times)


def test_the_report_is_one_file_without_external_links(run: Run) -> None:
    html = (run[0] / "report.html").read_text()
    assert "isolated" in html
    assert ">G12</td>" in html  # isolated, in the table of faults
    assert 'src="http' not in html


def test_a_second_run_without_a_report_gives_the_same_bytes(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    again = tmp_path / "again"
    command = ["run", str(SHORT), "--out", str(again), "--zenoh", "off", "--no-report"]
    assert cli.main(command) == 0
    assert not (again / "report.html").exists()
    assert "report " not in capsys.readouterr().out
    for name in ("received.tlog", "sent.tlog", "labels.jsonl", "results.jsonl"):
        assert (again / name).read_bytes() == (run[0] / name).read_bytes(), name


def test_decisions_are_published_during_the_run(tmp_path: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        url = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    command = [sys.executable, "-m", "mavproxy_fault.cli", "run", str(SHORT), "--speed", "4"]
    command += ["--out", str(tmp_path / "zenoh"), "--zenoh", url, "--gcs", "off"]
    got: queue.Queue[bytes] = queue.Queue()
    with (
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process,
        client(url, process) as bus,
    ):
        bus.subscribe("fdi/events", lambda _, payload: got.put(payload))
        assert process.wait(timeout=100) == 0
    events = [decode(got.get()) for _ in range(got.qsize())]
    hypotheses = {event.hypothesis for event in events if isinstance(event, Decision)}
    assert "satellites" in hypotheses


def client(url: str, process: "subprocess.Popen[bytes]") -> Bus:
    """Open a session with the router of a run, as soon as it is available."""
    while process.poll() is None:
        try:
            return open_bus(url, run="zenoh")
        except ConfigError:
            continue
    raise AssertionError("the run ended before its router was seen")


def test_a_run_that_misses_a_criterion_ends_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "strict.yaml"
    text = SHORT.read_text().replace("max_false_alarms: 0", "max_position_rmse_m: 0.001")
    file.write_text(
        text.replace("duration_s: 8", "duration_s: 2").replace("must_isolate", "must_detect")
    )
    assert cli.main(["run", str(file), "--out", str(tmp_path / "out"), "--zenoh", "off"]) == 1
    assert "position RMSE" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("max_false_alarms", "max_smoke"), "max_smoke"),
        (("fault: bias", "fault: bios"), "bios"),
        (("kind: fixedwing", "kind: submarine"), "submarine"),
        (("seed: 7", "seed: -7"), "seed = -7 "),
    ],
)
def test_a_wrong_scenario_is_refused_with_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], said: str
) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text(SHORT.read_text().replace(*change))
    assert cli.main(["run", str(file), "--out", str(tmp_path / "out")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_earlier_run_is_not_overwritten(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["run", str(SHORT), "--out", str(run[0])]) == 2
    assert "earlier run" in capsys.readouterr().err
