"""The scenario file: the demo, presets, and errors that name line and what is allowed."""

from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from simvehicle.scenario.scenario_file import Scenario, SensorSuite, read_scenario
from simvehicle.sensors.imu import ImuSensor


def read(tmp_path: Path, text: str) -> Scenario:
    """Read a scenario from its text."""
    path = tmp_path / "flight.yaml"
    path.write_text(text)
    return read_scenario(path)


def test_the_demo_is_a_fixed_wing_with_its_sensors() -> None:
    demo = read_scenario(None)
    assert demo.vehicle.kind == "fixedwing"
    assert demo.duration_s == 120.0
    assert isinstance(demo.sensors.imu, ImuSensor)
    assert demo.sensors.imu.rate_hz == 250.0


def test_an_empty_mapping_is_a_scenario_of_defaults(tmp_path: Path) -> None:
    assert read(tmp_path, "{}") == Scenario()


def test_a_preset_fills_in_missing_keys(tmp_path: Path) -> None:
    text = "sensors:\n  imu: {preset: beard-mclain, rate_hz: 100, gyro: {sigma: 0.5}}\n"
    imu = read(tmp_path, text).sensors.imu
    assert isinstance(imu, ImuSensor)
    assert imu.gyro.sigma == 0.5
    assert imu.accel.sigma == pytest.approx(0.0025 * 9.80665)


def test_sensors_may_be_in_a_separate_file(tmp_path: Path) -> None:
    (tmp_path / "board.yaml").write_text("imu: {preset: icm20602}\nbaro: {rate_hz: 20}\n")
    apart = read(tmp_path, "sensors: board.yaml\n")
    combined = read(tmp_path, "sensors: {imu: {preset: icm20602}, baro: {rate_hz: 20}}\n")
    assert apart.sensors == combined.sensors


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("imu:\n  rate: 3\n", r"board.yaml:2: imu.rate is unknown; did you mean rate_hz"),
        ("mag:\n  preset: x\n", r"board.yaml:2: mag.preset = x is unknown"),
        ("- imu\n", r"board.yaml:1: has no sensors"),
    ],
)
def test_an_error_in_a_sensor_file_names_that_file(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "board.yaml").write_text(text)
    with pytest.raises(ConfigError, match=message):
        read(tmp_path, "sensors: board.yaml\n")


def test_a_list_of_sensors_numbers_them(tmp_path: Path) -> None:
    imus = read(tmp_path, "sensors:\n  imu: [{rate_hz: 250}, {rate_hz: 100}]\n").sensors.imu
    assert isinstance(imus, list)
    assert [imu.id for imu in imus] == [0, 1]


def test_sections_of_other_parts_pass_through(tmp_path: Path) -> None:
    assert read(tmp_path, "schedule: {faults: [{id: a}]}\n").schedule == {"faults": [{"id": "a"}]}


WRONG = [
    ("durations_s: 3\n", r"flight.yaml:1: durations_s is unknown; did you mean duration_s"),
    (
        "name: a\nduration_s: soon\n",
        r"flight.yaml:2: duration_s = 'soon' does not fit: expected `float`",
    ),
    ("duration_s: -1\n", r"duration_s = -1 is out of range; above 0 is allowed"),
    ("start:\n  lat_deg: 95\n", r"flight.yaml:2: start.lat_deg = 95 is out of range"),
    ("mission:\n- {shape: circle}\n- {shape: oval}\n", r"flight.yaml:3: mission\[1\].shape"),
    ("mission:\n- {size_m: 3}\n", r"flight.yaml:2: mission\[0\] lacks shape"),
    (
        "sensors:\n  imu: {rate: 3}\n",
        r"flight.yaml:2: sensors.imu.rate is unknown; did you mean rate_hz",
    ),
    ("sensors:\n  mag:\n    preset: x\n", r"flight.yaml:3: sensors.mag.preset = x is unknown"),
    (
        "sensors:\n  baro: {noise: {sigma: -1}}\n",
        r"sigma = -1 is out of range; 0 or more",
    ),
    (
        "sensors:\n  imu: {gyro: {bias: [0.1, 0.2]}}\n",
        r"gyro.bias has 2 numbers; one, or a list of 3",
    ),
    ("sensors:\n  imu: {id: 300}\n", r"id = 300 is out of range; 0 or more, at most 255"),
    ("sensors:\n  range: {min_m: 5, max_m: 1}\n", r"min_m = 5.0, max_m = 1.0 is not a range"),
    (
        "sensors:\n  mag:\n    latency_s: .nan\n",
        r"flight.yaml:3: sensors.mag.latency_s = nan is not",
    ),
    ("mission:\n- shape: s\n  size_m: .inf\n", r"flight.yaml:3: mission\[0\].size_m = inf is not"),
    ("sensors: nowhere.yaml\n", r"nowhere.yaml: cannot be read"),
    (
        "environment: {gusts: {sigma_mps: [1, 1, 1], length_m: [0, 1, 1]}}\n",
        r"length_m\[0\] = 0 is out of range",
    ),
    ("environment: {shear: {reference_m: 0}}\n", r"reference_m = 0 is out of range"),
    ("gnss: {rate_hz: 0}\n", r"flight.yaml:1: gnss.rate_hz = 0 is out of range"),
    ("environment: {gusts: strong}\n", r"flight.yaml:1: environment.gusts"),
    ("start: {time: 2024-03-07T12:00:00}\n", r"flight.yaml:1: start.time has no time zone"),
    ("sensors: {imu: {}}\nsensors: {}\n", r"flight.yaml:2: sensors is given twice"),
    ("- a\n", r"flight.yaml: is not a scenario"),
    ("a: [\n", r"flight.yaml:2: not YAML"),
]


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_an_error_names_the_line_and_what_is_allowed(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        read(tmp_path, text)


@pytest.mark.parametrize("sensor", SensorSuite.__struct_fields__)
def test_no_sensor_takes_a_rate_of_zero(tmp_path: Path, sensor: str) -> None:
    with pytest.raises(ConfigError, match=rf"sensors.{sensor}.*rate_hz = 0 is out of range"):
        read(tmp_path, f"sensors: {{{sensor}: {{rate_hz: 0}}}}\n")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere.yaml: cannot be read"):
        read_scenario(tmp_path / "nowhere.yaml")
