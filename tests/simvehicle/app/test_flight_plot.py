"""`sim --plot`: a plot of path and states, and clear errors."""

import re
from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from simvehicle.app.flight_plot import plot_scenario, trace_flight
from simvehicle.scenario.scenario_file import Leg, Scenario, SensorSuite, StartConfig, read_scenario
from simvehicle.sensors.imu import ImuSensor

SHORT = Scenario(
    duration_s=4.0,
    start=StartConfig(height_m=100.0),
    mission=[Leg(shape="line", size_m=500.0)],
    sensors=SensorSuite(imu=ImuSensor(rate_hz=50.0)),
)


def test_a_flight_is_recorded_at_ten_hertz() -> None:
    flight = trace_flight(SHORT)
    assert len(flight.t_s) == 40
    assert flight.r_ned_m[-1, 0] == pytest.approx(100.0, abs=5.0)
    assert flight.plan_m[-1, 0] == pytest.approx(500.0, abs=5.0)


def test_a_picture_is_written(tmp_path: Path) -> None:
    path = tmp_path / "flight.png"
    assert plot_scenario(SHORT, None, path) == 0
    assert path.read_bytes().startswith(b"\x89PNG")


def test_a_file_name_without_a_picture_suffix_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"--plot: flight.txt is not a picture file; use one of .png"
    ):
        plot_scenario(SHORT, None, "flight.txt")


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written"):
        plot_scenario(SHORT, None, tmp_path / "nowhere" / "flight.png")


def test_the_documented_scenario_reads(tmp_path: Path) -> None:
    page = Path(__file__).parents[3] / "docs" / "simulator.md"
    found = re.search(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    path = tmp_path / "documented.yaml"
    path.write_text(found[1], encoding="utf-8")
    scenario = read_scenario(path)
    assert scenario.name == "night"
    assert all(
        getattr(scenario.sensors, kind) is not None for kind in SensorSuite.__struct_fields__
    )
