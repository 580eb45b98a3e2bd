import re
from pathlib import Path

import pytest

from analysis.run.proxied_flight import ProxiedFlight
from analysis.run.run_setup import read_setup
from analysis.run.vehicle_judging import report_unmatched_faults
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from simvehicle.scenario.changed_scenario import parse_change

HOVER = str(Path(__file__).parents[3] / "examples" / "hover.yaml")


@pytest.mark.parametrize("head", ["schedule:\n  faults:\n", "schedule:\n"])
def test_a_wrong_fault_in_a_scenario_is_reported_with_its_line(head: str, tmp_path: Path) -> None:
    right = "    - {fault: bias, target: HIL_SENSOR.xgyro, value: 1}\n"
    path = tmp_path / "scenario.yaml"
    path.write_text("# mine\n" + head + right + right.replace("bias", "bais"))
    line = len(path.read_text().splitlines())
    with pytest.raises(ConfigError, match=rf"scenario\.yaml:{line}: faults\[1\]\.fault = bais"):
        read_setup(str(path))


def test_another_schedule_drops_the_requirements_on_the_scenarios_faults(tmp_path: Path) -> None:
    path = tmp_path / "other.yaml"
    entries = "{id: %s, fault: bias, target: HIL_SENSOR.xgyro, value: 1}"
    path.write_text(f"faults: [{entries % 'gyro-step'}, {entries % 'mine'}]\n")
    assert "imu-dropout" in read_setup(None).criteria.must_detect
    assert read_setup(None, str(path)).criteria.must_detect == ("gyro-step",)


@pytest.mark.parametrize(
    ("section", "error"),
    [
        ("monitor: 5", "scenario.yaml:2: monitor = 5 does not fit"),
        ("monitor: {mask_deg: ten}", "scenario.yaml:2: monitor.mask_deg = 'ten' does not fit"),
        ("monitor: {attitude: {rate_hz: 0}}", "monitor.attitude.rate_hz = 0 is out of range"),
        ("monitor: {doppler: maybe}", "monitor.doppler = 'maybe' does not fit"),
        ("monitor: {left_out: 2.5}", "monitor.left_out = 2.5 does not fit"),
        (
            "monitor:\n  p_false_alarm: 1",
            "scenario.yaml:3: monitor.p_false_alarm = 1 is out",
        ),
        ("monitor: {sigma: {floor_m: .nan}}", "monitor.sigma.floor_m = nan is not finite"),
        ("monitor: {rule: best}", "monitor.rule = 'best' is unknown; known: explicit"),
        ("monitor: {systems: X}", "monitor.systems = 'X' names no system or an unknown one"),
        ("monitor: {fusion: {lag_s: -1}}", "monitor.fusion.lag_s = -1 is out of range"),
        ("criteria: {must_detect: 3}", "scenario.yaml:2: criteria.must_detect = 3 does not fit"),
        ("criteria: {must: [a]}", "criteria.must is unknown; did you mean must_"),
        ("criteria: [a]", "scenario.yaml:2: criteria = ['a'] does not fit"),
    ],
)
def test_each_section_is_checked_before_anything_starts(
    section: str, error: str, tmp_path: Path
) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(f"seed: 1\n{section}\n")
    with pytest.raises(ConfigError) as caught:
        read_setup(str(path))
    assert error in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_numbers_with_an_exponent_are_numbers_in_every_section(tmp_path: Path) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text("duration_s: 1e1\nmonitor: {p_false_alarm: 1e-4, sigma: {slow_s: 3E2}}\n")
    setup = read_setup(str(path))
    assert setup.scenario.duration_s == 10.0
    assert setup.monitor.detector.p_false_alarm == 1e-4
    assert setup.monitor.detector.sigma.slow_s == 300.0


def test_single_values_of_a_scenario_can_be_set() -> None:
    wind = "environment.wind_ned_mps[1]"
    setup = read_setup(None, changes=dict([parse_change(f"{wind}=4.5"), parse_change("seed=7")]))
    assert setup.scenario.environment.wind_ned_mps[1] == 4.5
    assert setup.scenario.seed == 7
    assert read_setup(None).scenario.environment.wind_ned_mps[1] != 4.5


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ("environment.wnd=4", "environment.wnd: wnd is unknown; known: wind_ned_mps"),
        ("environment.wind_ned_mps[3]=4", "index 3 is out of range; use 0 to 2"),
        ("seed.x=4", "has no x"),
        ("duration_s=long", "duration_s=long: duration_s = 'long' does not fit"),
        ("duration_s", "--set duration_s: has no =; write PATH=VALUE"),
        ("=4", "is not a path"),
    ],
)
def test_a_value_that_cannot_be_set_is_reported(change: str, error: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(error)):
        read_setup(None, changes=dict([parse_change(change)]))


@pytest.mark.parametrize(
    ("target", "known"),
    [
        ("PLANT.motor_efficiency[5]", "motor_efficiency[3]"),
        ("PLANT.elevator_efficiency", "motor_efficiency[0]"),
        ("PLANT.pseudorange_m[G12]", "mass_kg_add"),
    ],
)
def test_a_plant_fault_of_a_missing_part_is_refused(
    target: str, known: str, tmp_path: Path
) -> None:
    """Otherwise it would never act and count as missed."""
    schedule = tmp_path / "faults.yaml"
    schedule.write_text(f"faults: [{{id: a, fault: plant, target: '{target}', value: 0.5}}]\n")
    name = target.removeprefix("PLANT.")
    with pytest.raises(ConfigError, match=f"fault a: plant: {re.escape(name)} is unknown") as error:
        read_setup(HOVER, str(schedule))
    assert known in str(error.value)


@pytest.mark.parametrize(
    ("scenario", "fault", "error"),
    [
        (
            None,  # a fixed wing with a GNSS receiver, whose plant faults it may not hide
            "{id: a, preset: rotor-unbalance}",
            r"fault a: plant: rotor_unbalance_kgm\[0\] is unknown to this fixedwing; known: mass",
        ),
        (
            None,
            "{id: a, preset: actuator-stuck}",
            r"controls\[0\] drives no actuator of this vehicle; use HIL.*\[7\] \(elevator\), HIL",
        ),
        (
            HOVER,
            "{id: a, preset: actuator-stuck, target: 'HIL_ACTUATOR_CONTROLS.controls[4]'}",
            r"controls\[4\] drives no actuator of this vehicle; use .*\[3\] \(motor 4\)$",
        ),
    ],
)
def test_a_fault_of_a_missing_part_is_refused_in_a_schedule_and_in_flight(
    scenario: str | None, fault: str, error: str, tmp_path: Path
) -> None:
    path = tmp_path / "faults.yaml"
    path.write_text(f"faults: [{fault}]\n")
    with pytest.raises(ConfigError, match=error):
        read_setup(scenario, str(path))
    flight = ProxiedFlight(read_setup(scenario).scenario, Schedule())
    with pytest.raises(ConfigError, match=error):
        flight.control.answer("x/@ctl/schedule/load", path.read_bytes(), 0)
    assert flight.engine.ids() == []


def test_a_compass_fault_is_refused_without_a_compass(tmp_path: Path) -> None:
    path = tmp_path / "faults.yaml"
    path.write_text("faults: [{id: a, preset: compass-motor-current}]\n")
    read_setup(HOVER, str(path))
    with pytest.raises(ConfigError, match="compass_y_gauss_per_a is unknown to this multirotor"):
        read_setup(HOVER, str(path), changes={"sensors.mag": None})


def test_a_schedule_whose_faults_matched_no_message_gives_no_verdict() -> None:
    schedule = parse_schedule("faults: [{id: a, preset: airspeed-blockage}]")
    summary = {"verdict": "PASS"}
    report_unmatched_faults(summary, schedule, [])
    assert summary == {"verdict": "NO VERDICT", "never_acted": ["a (airspeed-blockage)"]}
    none: dict[str, object] = {"verdict": "PASS"}
    report_unmatched_faults(none, Schedule(), [])
    assert none == {"verdict": "PASS", "never_acted": []}
