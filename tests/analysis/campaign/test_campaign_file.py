from pathlib import Path

import pytest

from analysis.campaign.campaign_file import Magnitudes, read_campaign
from mavproxy_fault.documents.errors import ConfigError

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
RIGHT = """\
subjects: [ekf]
scenarios: [hover.yaml]
onsets: [5]
faults:
  - {fault: bias, target: HIL_SENSOR.xgyro, magnitudes: [0.1]}
"""


def reading(tmp_path: Path, text: str):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    return read_campaign(path)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("campaign_*.yaml")), ids=lambda p: p.stem)
def test_the_examples_are_valid(path: Path) -> None:
    assert read_campaign(path).faults


def test_a_range_of_magnitudes_is_evenly_spaced() -> None:
    assert Magnitudes(low=0.1, high=1000.0).spaced_values() == [0.1, 1.0, 10.0, 100.0, 1000.0]
    assert Magnitudes(low=-1, high=1, count=3, spacing="linear").spaced_values() == [-1.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("ekf", "ekg"), r"c.yaml:1: subjects\[0\] = ekg is unknown"),
        (("bias", "bais"), r"c.yaml:5: faults\[0\].*bais is unknown"),
        (("xgyro", "xgiro"), "xgiro"),
        (("onsets: [5]", "onsets: [nowhere]"), "onsets: nowhere .*seconds, a phase"),
        (("onsets: [5]", "onsets: []"), "onsets is empty"),
        (("onsets: [5]", "onset: [5]"), "c.yaml:3: onset is unknown"),
        (("[0.1]", "{low: 2, high: 1}"), "low = 2.0 must be below"),
        (("[0.1]", "{low: 0, high: 1}"), "must be above 0"),
        (("fault: bias, ", ""), "exactly one of fault, preset and faults"),
        (("onsets: [5]", "find: critical"), None),
    ],
)
def test_a_wrong_value_is_reported(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    text = RIGHT.replace(*change)
    if message is None:
        text = text.replace(", magnitudes: [0.1]", "")
        message = "magnitudes are missing"
    with pytest.raises(ConfigError, match=message):
        reading(tmp_path, text)


def test_faults_of_the_same_name_need_ids(tmp_path: Path) -> None:
    fault = RIGHT.splitlines()[-1]
    with pytest.raises(ConfigError, match="occurs twice"):
        reading(tmp_path, RIGHT + fault + "\n")
