"""docs/extending.md, tried literally: its files and lines go into a copy, its commands are run."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from mavproxy_fault import cli

ROOT = Path(__file__).parents[1]
PACKAGES = ("mavproxy_fault", "simvehicle", "analysis")
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
PART = re.compile(
    r"`((?:(?:mavproxy_fault|simvehicle|analysis)/[\w/-]+|night|jumps)\.\w+)`"
    r"|^```(\w+)\n(.*?)^```",
    re.S | re.M,
)

TRY = """
import socket, tempfile
import numpy as np
from analysis.estimators import make_estimator
from analysis.estimators.estimator import Prior
from analysis.field_maps.field_map import TLOG
from analysis.report.flight_checks import _files
from analysis.report.curves.panels import PANELS
from analysis.samples.decoder import SAMPLE_LINES
from analysis.samples.sample import ImuSample
from mavproxy_fault.links.spec import open_link
from simvehicle.hil.hil_messages import READING_MESSAGES
from simvehicle.scenario.scenario_file import SensorSuite
from simvehicle.sensors.readings import TemperatureReading
from simvehicle.sensors.thermometer import Thermometer
from simvehicle.simulation.vehicle_kinds import find_vehicle_kind

path = tempfile.mkdtemp() + "/it"
server = socket.socket(socket.AF_UNIX)
server.bind(path)
server.listen()
link = open_link(f"unix:{path}")
there, _ = server.accept()
link.write(b"out")
assert there.recv(9) == b"out"
there.sendall(b"in")
assert link.read() == [(0, b"in")]

estimator = make_estimator("gyro-only")
state = estimator.start(Prior(0, np.array([1.0, 0, 0, 0])))
for t_us in range(10_000, 1_010_000, 10_000):
    sample = ImuSample(t_us, np.array([0.0, 0.0, 0.1]), np.zeros(3))
    estimate, state = estimator.update(sample, state)
assert abs(2 * np.arctan2(estimate.q_nb[3], estimate.q_nb[0]) - 0.1) < 1e-9

assert "VICON_POSITION_ESTIMATE" in SAMPLE_LINES
assert any(file.__name__.endswith("radio_checks") for file in _files())
assert TLOG["HYGROMETER_SENSOR"][0].target == "humidity"
assert any(panel.key == "humidity" for panel in PANELS)
assert SensorSuite(thermometer=Thermometer()).thermometer.rate_hz == 1.0
layout, values = READING_MESSAGES[TemperatureReading](TemperatureReading(0, 21.5), 0)
assert (layout.name, values["temperature"]) == ("HYGROMETER_SENSOR", 2150)
assert find_vehicle_kind("glider").read("aerosonde-2012").plant["motor_efficiency[0]"] == 0.0
"""


def parts() -> list[tuple[str, str, str]]:
    """(file, language, text) of every block; the file is the last one named before it."""
    found, file = [], ""
    for part in PART.finditer(PAGE):
        if part[1]:
            file = part[1]
        else:
            found.append((file, part[2], part[3]))
    return found


def inserted(path: Path, diff: str) -> None:
    """Put the lines that begin with + behind the lines before them."""
    lines = diff.splitlines()
    context = "\n".join(line[1:] for line in lines if not line.startswith("+")) + "\n"
    added = "\n".join(line[1:] for line in lines if line.startswith("+")) + "\n"
    text = path.read_text(encoding="utf-8")
    assert text.count(context) == 1, f"{path} holds {text.count(context)} times\n{context}"
    path.write_text(text.replace(context, context + added), encoding="utf-8")


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources with everything that the page adds."""
    folder = tmp_path_factory.mktemp("copy")
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    for file, language, text in parts():
        if language == "diff":
            inserted(folder / file, text)
        elif language in ("python", "yaml") and "/" in file:  # not of another package
            assert not (folder / file).exists(), f"{file} is there already"
            (folder / file).write_text(text, encoding="utf-8")
    return folder


def run(copy: Path, *arguments: str, code: int = 0) -> str:
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=copy, env=environment, capture_output=True, text=True
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_the_commands_of_the_page_print_what_it_says(copy: Path) -> None:
    for _, language, text in parts():
        if language == "console":
            command, *expected = text.splitlines()
            printed = run(copy, "-m", "mavproxy_fault.cli", *command.split()[2:])
            assert all(line in printed for line in expected), printed


def test_what_the_page_adds_works(copy: Path) -> None:
    run(copy, "-c", TRY)


def test_what_the_page_adds_is_in_the_house_style(copy: Path) -> None:
    configured = ["--config", str(ROOT / "pyproject.toml")]
    run(copy, "-m", "ruff", "check", "--no-cache", *configured, *PACKAGES)
    run(copy, "-m", "ruff", "format", "--no-cache", "--check", *configured, *PACKAGES)


@pytest.fixture(scope="module")
def installed(
    tmp_path_factory: pytest.TempPathFactory, install_package: Callable[[Path], None]
) -> Path:
    """A folder with the detector that the page's command writes, and the page's scenarios."""
    folder = tmp_path_factory.mktemp("installed") / "baro-jump"
    assert cli.main(["new", "detector", "baro-jump", "--out", str(folder)]) == 0
    install_package(folder)
    for file, _, text in parts():
        if file in ("night.yaml", "jumps.yaml"):
            (folder / file).write_text(text, encoding="utf-8")
    return folder


CLI = ("-m", "mavproxy_fault.cli")


def test_a_detector_of_another_package_is_in_results_timeline_and_score(installed: Path) -> None:
    run(installed, *CLI, "run", "night.yaml", "--out", "night", "--zenoh", "off")
    lines = (installed / "night" / "results.jsonl").read_text(encoding="utf-8").splitlines()
    own = [row for row in map(json.loads, lines) if row.get("sensor") == "baro-jump"]
    alarms = [row for row in own if row["alarm"]]
    assert len(own) > 500
    assert {row["suspect"] for row in alarms} == {"baro"}
    assert {row["threshold"] for row in own} == {20.0}  # the scenario's setting
    assert "detected: baro-jump" in (installed / "night" / "report.html").read_text("utf-8")
    summary = json.loads((installed / "night" / "summary.json").read_text(encoding="utf-8"))
    (fault,) = summary["faults"]
    assert fault["verdict"] == "isolated"
    assert fault["delay_s"] <= 0.02  # one interval of the barometer
    assert fault["channels"] == ["baro", "baro-jump"]
    assert "baro-jump" in summary["watched"]
    assert summary["false_alarms"] == 0


def test_a_detector_of_another_package_is_a_subject_of_a_campaign(installed: Path) -> None:
    run(installed, *CLI, "campaign", "jumps.yaml", "--out", "jumps", "--workers", "1")
    with (installed / "jumps" / "cells.csv").open(encoding="utf-8") as file:
        outcomes = {(r["subject"], r["magnitude"]): r["outcome"] for r in csv.DictReader(file)}
    assert outcomes["baro-jump", "0.01"] == "unaffected"
    assert outcomes["baro-jump", "1.0"] == "detected"


def test_an_unknown_setting_of_a_detector_is_an_error_that_names_the_known(installed: Path) -> None:
    for wrong, known in (("baro_jump: {limit: 20}", "limit_pa"), ("baro_jumps: {}", "baro_jump")):
        (installed / "wrong.yaml").write_text(f"name: wrong\nmonitor:\n  {wrong}\n")
        said = run(installed, *CLI, "run", "wrong.yaml", "--out", "x", code=2)
        assert "is unknown" in said
        assert known in said
