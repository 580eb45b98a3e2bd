from pathlib import Path

import pytest

from analysis.run.setup import read_setup
from mavproxy_fault.documents.errors import ConfigError


@pytest.mark.parametrize("head", ["schedule:\n  faults:\n", "schedule:\n"])
def test_a_wrong_fault_in_a_scenario_is_told_with_its_line(head: str, tmp_path: Path) -> None:
    right = "    - {fault: bias, target: HIL_SENSOR.xgyro, value: 1}\n"
    path = tmp_path / "scenario.yaml"
    path.write_text("# mine\n" + head + right + right.replace("bias", "bais"))
    line = len(path.read_text().splitlines())
    with pytest.raises(ConfigError, match=rf"scenario\.yaml:{line}: faults\[1\]\.fault = bais"):
        read_setup(str(path))


def test_another_schedule_is_not_asked_for_the_scenarios_own_faults(tmp_path: Path) -> None:
    path = tmp_path / "other.yaml"
    entries = "{id: %s, fault: bias, target: HIL_SENSOR.xgyro, value: 1}"
    path.write_text(f"faults: [{entries % 'gyro-step'}, {entries % 'mine'}]\n")
    assert "imu-dropout" in read_setup(None).criteria.must_detect
    assert read_setup(None, str(path)).criteria.must_detect == ("gyro-step",)
