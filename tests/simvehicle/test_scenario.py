"""The scenario file: the demo, presets, and errors that name line and what is allowed."""

from pathlib import Path

import pytest

from mavproxy_fault.errors import ConfigError
from simvehicle.scenario import Scenario, read_scenario
from simvehicle.sensors.imu import Imu


def read(tmp_path: Path, text: str) -> Scenario:
    """Read a scenario from its text."""
    path = tmp_path / "flight.yaml"
    path.write_text(text)
    return read_scenario(path)


def test_the_demo_is_a_fixed_wing_with_its_sensors() -> None:
    demo = read_scenario(None)
    assert demo.vehicle.kind == "fixedwing"
    assert demo.duration_s == 120.0
    assert isinstance(demo.sensors.imu, Imu)
    assert demo.sensors.imu.rate_hz == 250.0


def test_an_empty_mapping_is_a_scenario_of_defaults(tmp_path: Path) -> None:
    assert read(tmp_path, "{}") == Scenario()


def test_a_preset_fills_in_what_is_not_given(tmp_path: Path) -> None:
    text = "sensors:\n  imu: {preset: beard-mclain, rate_hz: 100, gyro: {sigma: 0.5}}\n"
    imu = read(tmp_path, text).sensors.imu
    assert isinstance(imu, Imu)
    assert imu.gyro.sigma == 0.5
    assert imu.accel.sigma == pytest.approx(0.0025 * 9.80665)


def test_a_list_of_sensors_numbers_them(tmp_path: Path) -> None:
    imus = read(tmp_path, "sensors:\n  imu: [{rate_hz: 250}, {rate_hz: 100}]\n").sensors.imu
    assert isinstance(imus, list)
    assert [imu.id for imu in imus] == [0, 1]


def test_sections_of_other_parts_pass_through(tmp_path: Path) -> None:
    assert read(tmp_path, "schedule: {faults: [{id: a}]}\n").schedule == {"faults": [{"id": "a"}]}


WRONG = [
    ("durations_s: 3\n", r"flight.yaml:1: durations_s is unknown; known: name, seed, duration_s"),
    ("name: a\nduration_s: soon\n", r"flight.yaml:2: duration_s is wrong; expected `float`"),
    ("duration_s: -1\n", r"duration_s = -1.0 is not positive"),
    ("start:\n  lat_deg: 95\n", r"flight.yaml:1: start is wrong; lat_deg = 95.0 is out of range"),
    ("mission:\n- {shape: circle}\n- {shape: oval}\n", r"flight.yaml:3: mission\[1\].shape"),
    ("mission:\n- {size_m: 3}\n", r"flight.yaml:2: mission\[0\].shape is missing"),
    ("sensors:\n  imu: {rate: 3}\n", r"flight.yaml:2: sensors.imu.rate is unknown; known: rate_hz"),
    ("sensors:\n  mag:\n    preset: x\n", r"flight.yaml:3: sensors.mag.preset = x is unknown"),
    ("sensors:\n  baro: {noise: {sigma: -1}}\n", r"sigma = -1.0 is negative"),
    ("environment: {gusts: strong}\n", r"flight.yaml:1: environment.gusts"),
    ("- a\n", r"flight.yaml:1: is no scenario"),
    ("a: [\n", r"flight.yaml:2: .*valid YAML is expected"),
]


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_an_error_names_the_line_and_what_is_allowed(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        read(tmp_path, text)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere.yaml: cannot be read"):
        read_scenario(tmp_path / "nowhere.yaml")
