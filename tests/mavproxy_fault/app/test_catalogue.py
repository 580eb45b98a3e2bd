import json
from pathlib import Path

import jsonschema
import msgspec
import pytest
import yaml

from mavproxy_fault.app.catalogue import schedule_schema
from mavproxy_fault.app.preview import preview_curves
from mavproxy_fault.cli import main
from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.faults.satellite import SatelliteFault
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.schedule.presets import preset_names

SCHEDULE = """\
seed: 1
faults:
  - {id: step, fault: bias, target: HIL_SENSOR.xgyro, value: 0.1, at_s: 3, for_s: 2}
  - {id: sat, preset: satellite-ramp, after: step}
  - {id: lost, fault: drop, value: 0.2, when: armed}
"""


@pytest.fixture
def schedule(tmp_path: Path) -> Path:
    path = tmp_path / "night.yaml"
    path.write_text(SCHEDULE)
    return path


def test_the_list_has_one_line_for_every_fault_and_preset(
    capsys: pytest.CaptureFixture[str],
) -> None:
    main(["faults", "list"])
    words = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert words == ["faults", *known_faults(), "presets", *preset_names()]


def test_programs_get_the_result_as_json(
    schedule: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, key in (
        (("list",), "faults"), (("list", "--messages"), "messages"), (("show", "bias"), "text"),
        (("check", str(schedule)), "faults"),
    ):  # fmt: skip
        assert main(["faults", *words, "--json"]) == 0
        assert key in json.loads(capsys.readouterr().out)


def test_show_lists_the_parameters_of_a_fault(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["faults", "show", "jitter"]) == 0
    text = capsys.readouterr().out
    assert (
        "distribution: exponential | normal | pareto | pareto-normal | samples | uniform"
        " (default uniform)" in text
    )
    assert "base_s: number (default 0.0)" in text


def test_show_lists_the_entries_of_a_preset(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["faults", "show", "imu-impulse"]) == 0
    assert "HIL_SENSOR.zacc" in capsys.readouterr().out


def test_show_suggests_a_name_near_a_wrong_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["faults", "show", "jiter"]) == 2
    assert "did you mean jitter" in capsys.readouterr().err


def test_check_describes_the_entries_of_a_schedule(
    schedule: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["faults", "check", str(schedule)]) == 0
    text = capsys.readouterr().out
    assert "step: bias, HIL_SENSOR.xgyro, from 3 s, for 2 s" in text
    assert "sat: satellite-ramp, PSEUDORANGE.G12, after the end of step, without end" in text
    assert "lost: drop, everything, when armed, without end" in text


def test_check_of_an_invalid_schedule_exits_with_2(
    schedule: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    schedule.write_text(SCHEDULE.replace("drop", "dorp").replace("bias", "bais"))
    assert main(["faults", "check", str(schedule)]) == 2
    text = capsys.readouterr().err
    assert "night.yaml:3:" in text
    assert "night.yaml:5:" in text


def test_plot_writes_an_image(schedule: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / "night.png"
    assert main(["faults", "plot", str(schedule), "--out", str(out)]) == 0
    assert out.read_bytes().startswith(b"\x89PNG")


def test_a_preset_of_more_satellites_than_one_message_holds_is_drawn() -> None:
    faults = parse_schedule({"faults": [{"preset": "gps-search-failure"}]}).faults
    ranges = next(entry for entry in faults if isinstance(entry.fault, SatelliteFault))
    curves = preview_curves(msgspec.structs.replace(ranges, for_s=1.0), 0)
    assert curves[0].name == "G01, m"
    assert curves[0].lost


@pytest.mark.parametrize("name", ["plot.txt", "missing/plot.png"])
def test_a_plot_that_cannot_be_written_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["faults", "plot", "gyro-drift", "--out", str(tmp_path / name)]) == 2
    assert "give a PNG, SVG or PDF" in capsys.readouterr().err


def test_the_schema_accepts_and_refuses_the_same_as_the_reader() -> None:
    checker = jsonschema.Draft202012Validator(json.loads(json.dumps(schedule_schema())))
    checker.check_schema(checker.schema)
    checker.validate(yaml.safe_load(SCHEDULE))
    for wrong in ("bais", "drift, rate: 3"):
        data = yaml.safe_load(SCHEDULE.replace("fault: bias", f"fault: {wrong}"))
        assert not checker.is_valid(data)
