"""Requirements on flights: `run`, `monitor` and `report` as a user runs them."""

import io
import json
import subprocess
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
import yaml

from mavproxy_fault.cli import main

SCENARIO = {
    "name": "motor", "duration_s": 8, "start": {"height_m": 20},
    "vehicle": {"kind": "multirotor", "parameters": "iris"},
    "sensors": {"imu": {"preset": "consumer-mems", "rate_hz": 100},
                "gps": {"preset": "consumer", "rate_hz": 5}},
    "requirements": ["no_crash", "keeps_height", {"name": "low", "formula": "height_m < 100"}],
}  # fmt: skip
MOTOR = {"id": "m", "fault": "plant", "target": "PLANT.motor_efficiency[1]", "value": 0.0,
         "at_s": 2, "for_s": 6}  # fmt: skip


def command(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """A command in this process, with what it printed."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as errors:
        code = main([str(argument) for argument in arguments])
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), errors.getvalue())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("motor")
    (place / "motor.yaml").write_text(yaml.safe_dump(SCENARIO | {"schedule": {"faults": [MOTOR]}}))
    (place / "calm.yaml").write_text(yaml.safe_dump(SCENARIO))
    return place


def fly(folder: Path, name: str, *more: str) -> tuple[int, str, dict]:
    done = command("run", folder / f"{name}.yaml", "--out", folder / name, "--no-report",
                   "--zenoh", "off", *more)  # fmt: skip
    rows = json.loads((folder / name / "summary.json").read_text())["requirements"]
    return done.returncode, done.stdout, {row["name"]: row for row in rows}


def test_a_stopped_motor_violates_what_it_should_and_the_verdict_fails(folder: Path) -> None:
    code, text, rows = fly(folder, "motor", "--require", "fault -> eventually[0,1](detected)")
    assert code == 1
    assert not rows["no_crash"]["met"]
    assert not rows["keeps_height"]["met"]
    assert rows["keeps_height"]["robustness"] == pytest.approx(-4.0, abs=1.0)
    assert 3.0 < rows["no_crash"]["at_s"] < 8.0
    assert rows["low"]["met"]
    assert rows["low"]["unit"] == "m"
    assert "fault -> eventually[0,1](detected)" in rows
    assert "requirement     no_crash: violated at" in text

    # The same log by itself: its height counts from the start, the fall shows all the same.
    log = folder / "motor" / "sent.tlog"
    again = command("monitor", "--log", log, "--require", "no_crash", "--zenoh", "off")
    assert again.returncode == 1
    assert "no_crash: violated" in again.stdout
    (folder / "criteria.yaml").write_text("requirements: [no_crash]\n")
    out = folder / "report"
    command("report", log, "--criteria", folder / "criteria.yaml", "--out", out)
    assert "requirement: no_crash" in (out / "junit.xml").read_text()


def test_a_flight_without_a_fault_violates_nothing(folder: Path) -> None:
    code, _, rows = fly(folder, "calm")
    assert code == 0
    assert all(row["met"] for row in rows.values())
    assert rows["keeps_height"]["robustness"] == pytest.approx(15.0, abs=0.5)


def test_a_wrong_formula_is_refused_before_the_flight(folder: Path) -> None:
    done = command("run", folder / "calm.yaml", "--require", "always(hight_m > 5)")
    assert done.returncode == 2
    assert "did you mean height_m" in done.stderr
