"""Parameter files of a user, in the formats of three ground stations."""

from pathlib import Path

import pytest

from analysis.campaign.campaign_file import read_campaign
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.parameter_list import format_parameters, read_parameters


@pytest.mark.parametrize(
    "text",
    [
        "EK3_POS_I_GATE,1000\nEK3_GLITCH_RAD 0.5 # metres\n",  # Mission Planner, MAVProxy
        "\ufeff# Vehicle-Id Component-Id Name Value Type\n"  # QGroundControl
        "1\t1\tEK3_POS_I_GATE\t1000\t4\n1\t1\tEK3_GLITCH_RAD\t0.500000\t9\n",
    ],
)
def test_every_ground_stations_file_is_read(tmp_path: Path, text: str) -> None:
    file = tmp_path / "own.params"
    file.write_text(text, encoding="utf-8")
    found = read_parameters(str(file))
    assert found == {"EK3_POS_I_GATE": 1000.0, "EK3_GLITCH_RAD": 0.5}
    assert format_parameters(found) == "EK3_POS_I_GATE 1000\nEK3_GLITCH_RAD 0.5\n"


@pytest.mark.parametrize("line", ["EK3_GLITCH_RAD", "EK3_GLITCH_RAD wide", "A 1 2", "A nan"])
def test_a_line_that_is_not_a_parameter_is_reported_with_its_number(
    tmp_path: Path, line: str
) -> None:
    file = tmp_path / "own.parm"
    file.write_text(f"# own\n{line}\n")
    with pytest.raises(ConfigError, match=r"own\.parm:2: .* is not NAME VALUE"):
        read_parameters(str(file))


def test_parameters_of_a_subject_are_relative_to_the_campaign_file(tmp_path: Path) -> None:
    file = tmp_path / "campaign.yaml"
    file.write_text(
        "subjects: [{name: loose, autopilot: px4, binary: px4, parameters: loose.params}]\n"
        "scenarios: [hover.yaml]\nfaults: [{preset: gps-freeze}]\n"
    )
    with pytest.raises(ConfigError, match=r"loose\.params cannot be read"):
        read_campaign(file)
    (tmp_path / "loose.params").write_text("EKF2_GPS_P_GATE 100\n")
    subject = read_campaign(file).autopilot("loose")
    assert subject is not None
    words = ["--autopilot", "px4", "--binary", "px4"]
    assert subject.options(tmp_path) == [*words, "--parameters", str(tmp_path / "loose.params")]
