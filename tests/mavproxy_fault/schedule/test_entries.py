from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.schedule.entries import Schedule, never_acted, parse_schedule, read_schedule
from mavproxy_fault.wire.dialect import message_layout

GOOD = """\
seed: 1
faults:
  - id: gyro-step
    fault: bias
    target: HIL_SENSOR.xgyro
    value: 0.1
    at_s: 20
    for_s: 15
    where: {system: 1, component: 51, id: 0, direction: to-vehicle}
    probability: 1.0
  - fault: constant
    target: ['HIL_ACTUATOR_CONTROLS.controls[3]', HIL_SENSOR.xacc]
    profile: {segments: [{at_s: 0.2, for_s: 0.2, start: 1.0, rate: 5e-1}], mode: replace}
"""


def errors(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        parse_schedule(text, "night.yaml")
    return str(caught.value).splitlines()


def test_the_design_s_example_is_read() -> None:
    schedule = parse_schedule(GOOD)
    step, other = schedule.faults
    assert (schedule.seed, step.id, step.at_s, step.for_s) == (1, "gyro-step", 20, 15)
    assert (step.where.component, step.where.direction) == (51, "to-vehicle")
    assert other.id == "constant-2"
    assert other.ids == {
        message_layout("HIL_ACTUATOR_CONTROLS").id,
        message_layout("HIL_SENSOR").id,
    }
    assert other.fault.profile.segments[0].rate == 0.5  # type: ignore[attr-defined]


def test_an_empty_schedule_has_no_faults() -> None:
    assert parse_schedule("seed: 4") == Schedule(4)


def test_every_error_is_reported_with_its_line() -> None:
    found = errors("""\
seed: -1
faults:
  - fault: bais
    target: HIL_SENSOR.xgyro
  - fault: bias
    target: HIL_SENSOR.xgiro
    value: much
    at: 3
  - fault: drift
    target: HIL_SENSR.xgyro
    for_s: 0
    where: {sytem: 1, direction: up}
  - fault: constant
    target: HIL_SENSOR.xgyro
    profile: {segments: [{at_s: 1, for_s: 1, start: a}, {at_s: 2, fr_s: 1, start: 1}]}
other: 1
""")
    said = "\n".join(found)
    for part in [
        "night.yaml:1: seed = -1",
        "night.yaml:3: faults[0].fault = bais is unknown; did you mean bias",
        "night.yaml:6: faults[1].target = HIL_SENSOR.xgiro is not a numeric field of HIL_SENSOR; "
        "did you mean xgyro",
        "night.yaml:7: faults[1].value = 'much' does not fit",
        "night.yaml:8: faults[1].at is unknown; did you mean at_s",
        "night.yaml:9: faults[2] lacks value",
        "night.yaml:10: faults[2].target = HIL_SENSR is not a message; did you mean HIL_SENSOR",
        "night.yaml:11: faults[2].for_s = 0",
        "night.yaml:12: faults[2].where.sytem is unknown; did you mean system",
        "night.yaml:12: faults[2].where.direction = 'up' is unknown",
        "night.yaml:15: faults[3].profile.segments[0].start = 'a' does not fit",
        "night.yaml:15: faults[3].profile.segments[1].fr_s is unknown; did you mean for_s",
        "night.yaml:15: faults[3].profile.segments[1] lacks for_s",
        "night.yaml:16: other is unknown",
    ]:
        assert part in said, said
    assert len(found) == 14


def test_text_that_is_not_yaml_is_reported_with_its_line() -> None:
    assert errors("seed: 1\nfaults: [}\n")[0].startswith("night.yaml:2: not YAML")


def test_a_key_given_twice_is_refused() -> None:
    assert errors("seed: 1\nseed: 2\n") == ["night.yaml:2: seed is given twice; give each key once"]


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("{fault: bias, value: 1}", "target is missing; give MESSAGE.field"),
        ("{fault: bias, target: HIL_GPS.alt}", "needs exactly one of value and profile"),
        ("{fault: drop, target: HIL_GPS.alt}", "is a field; this fault needs a message"),
        ("{fault: bias, target: 'HIL_ACTUATOR_CONTROLS.controls[16]', value: 1}", "out of range"),
        ("{fault: bias, target: STATUSTEXT.text, value: 1}", "not a numeric field"),
        (
            "{fault: bias, target: [HIL_SENSOR.xacc, HIL_SENSOR.yacc], value: [1, 2, 3]}",
            "3 numbers",
        ),
        ("{fault: drift, target: [HIL_GPS.lat, HIL_GPS.lon], value: [1, 2, 3]}", "3 numbers"),
        ("{fault: noise, target: [PSEUDORANGE.G01, PSEUDORANGE.G02], value: [1]}", "1 numbers"),
        ("{fault: clear-bits, target: HIL_SENSOR.xacc, value: 3}", "has no flags; give an integer"),
        ("{fault: rotation, target: HIL_SENSOR.xacc, angles_deg: [1, 2, 3]}", "three fields"),
        ("{fault: not-a-number, target: HIL_GPS.alt}", "is an integer"),
        ("{fault: freeze, target: PSEUDORANGE.G12}", "is not a target for freeze"),
        ("{fault: bias, target: PSEUDORANGE.12, value: 1}", "is not a satellite"),
        ("{fault: plant, target: HIL_GPS, value: 1}", "give PLANT.<name>"),
        ("{fault: plant, target: PLANT.mas_kg_add, value: 1}", "did you mean mass_kg_add"),
        ("{fault: plant, target: 'PLANT.motor_efficiency[a]', value: 1}", "does not name a motor"),
        ("{fault: plant, target: 'PLANT.cn0_drop_db[R01]', value: 1}", "does not name a satellite"),
        ("{fault: plant, target: PLANT.mass_kg_add, value: .inf}", "value = inf is not finite"),
        ("{fault: bias, target: PSEUDORANGE.G33, value: 1}", "is not a satellite"),
        ("{fault: bias, target: PSEUDORANGE.R01, value: 1}", "is not a satellite"),
        (
            "{fault: bias, target: [HIL_SENSOR.xacc, HIL_SENSOR.xacc], value: 1}",
            "HIL_SENSOR.xacc is given twice",
        ),
        ("{fault: drop, target: [HIL_GPS, HIL_GPS]}", "HIL_GPS is given twice"),
        ("{fault: drop, at_s: .inf}", "at_s = inf is not finite"),
        ("{fault: drop, at_s: 1e300}", "at_s = 1e+300 is out of range; 0 or more, at most 1e+09"),
        ("{fault: delay, value: 1e300}", "value = 1e+300 is out of range"),
        ("{fault: drop, at_s: 1:30}", "at_s = '1:30' does not fit: expected `float`"),
        ("{fault: drop, at_s: 010}", "at_s = 010 may be octal; write 10"),
        ("{fault: drop, for_s: 2, repeat: {every_s: 1}}", "every_s = 1 is shorter than for_s = 2"),
        ("{fault: drop, when: 'armed and'}", "when "),
        ("{fault: bias, target: HIL_GPS.alt, value: 1, via: simulator}", "via: simulator needs"),
        ("{fault: drop, repeat: {every_s: 1}}", "needs for_s"),
        ("{fault: drop, after: nothing}", "is not another fault"),
        ("{target: HIL_GPS.alt}", "lacks fault; give `fault` or `preset`"),
        ("{preset: gps-jmup}", "is unknown; did you mean"),
        ("just text", "is not a fault"),
    ],
)
def test_inconsistent_keys_are_refused(entry: str, said: str) -> None:
    found = errors(f"faults:\n  - {entry}\n")
    assert len(found) == 1
    assert said in found[0]
    assert found[0].startswith("night.yaml:2: ")


@pytest.mark.parametrize("id", ["a/b", "a*b", "$", "a?b", "a#b", "@x", "all", "x" * 201])
def test_an_id_that_is_not_a_key_is_refused(id: str) -> None:
    (said,) = errors(f"faults:\n  - {{id: '{id}', fault: drop}}\n")
    assert said.startswith(f"night.yaml:2: faults[0].id = '{id[:200]}' is not valid; give ")
    assert parse_schedule("faults: [{id: gyro x bias, fault: drop}]").faults[0].id == "gyro x bias"


def test_two_faults_of_one_id_are_refused() -> None:
    assert "is given twice" in errors("faults: [{id: a, fault: drop}, {id: a, fault: drop}]")[0]


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_schedule(tmp_path / "none.yaml")


def test_the_default_via_applies_to_satellite_faults_without_one() -> None:
    entry = {"fault": "bias", "target": "PSEUDORANGE.G12", "value": 5}
    own = {"id": "b", "via": "proxy", **entry}
    data = {"faults": [{"id": "a", **entry}, own, {**entry, "target": "HIL_GPS.alt"}]}
    kinds = [type(e.fault).__name__ for e in parse_schedule(data, via="simulator").faults]
    assert kinds == ["ReceiverFault", "SatelliteFault", "Bias"]
    assert type(parse_schedule(data).faults[0].fault).__name__ == "SatelliteFault"


def test_an_invalid_entry_does_not_affect_errors_of_the_others() -> None:
    found = errors("""\
faults:
  - {id: a, fault: bais}
  - {id: b, fault: drop, after: a}
  - {id: c, fault: drop, after: missing}
  - {id: b, fault: drop}
  - {id: d, fault: bias, value: x, target: HIL_SENSOR.xacc, when: 'and', at: 3}
""")
    places = [":".join(error.split(" ")[:2]) for error in found]
    assert places == [
        "night.yaml:2::faults[0].fault",
        "night.yaml:4::faults[2].after",
        "night.yaml:5::faults[3].id",
        "night.yaml:6::faults[4].when",
        "night.yaml:6::faults[4].at",
        "night.yaml:6::faults[4].value",
    ]


def test_faults_that_wait_for_each_other_are_reported_once() -> None:
    found = errors("""\
faults:
  - {id: a, fault: drop, after: {id: b}}
  - {id: b, fault: drop, after: c}
  - {id: c, fault: drop, after: b}
  - {id: d, fault: drop, after: d}
""")
    assert found == [
        "night.yaml:3: faults[1].after is a cycle (b after c after b); remove one of them",
        "night.yaml:5: faults[3].after = d is not another fault; known: a, b, c",
    ]


def test_a_value_may_be_replaced_by_nan() -> None:
    text = "{fault: constant, target: HIL_SENSOR.xacc, value: %s}"
    for value in (".nan", "-.inf"):
        assert len(parse_schedule(f"faults: [{text % value}]").faults) == 1


def test_the_plant_is_not_a_message() -> None:
    entry = {"fault": "bias", "target": "PLANT.wind_n_mps", "value": 1}
    with pytest.raises(ConfigError, match="PLANT is the simulated plant, not a message; use"):
        parse_schedule({"faults": [entry]})


def test_an_ambiguous_number_does_not_hide_other_errors(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(
        "faults:\n"
        "- {id: a, fault: bias, target: HIL_SENSOR.xgyro, value: 010}\n"
        "- {id: b, fault: biass, target: HIL_SENSOR.xgyro, value: 1}\n"
        "- {id: b, fault: drop, target: HIL_GPS, after: missing}\n"
        "- {id: c, fault: drop, target: HIL_GPS, after: a}\n"
        "- {id: d, fault: drop, target: 010}\n"
    )
    with pytest.raises(ConfigError) as found:
        read_schedule(path)
    lines = [line.removeprefix(f"{path}:") for line in str(found.value).splitlines()]
    assert [line.partition(";")[0] for line in lines] == [
        "2: faults[0].value = 010 may be octal",
        "3: faults[1].fault = biass is unknown",
        "4: faults[2].id = b is given twice",
        "4: faults[2].after = missing is not another fault",
        "6: faults[4].target = 010 may be octal",
    ]


def test_unmatched_entries_are_listed_once_and_one_part_of_a_preset_is_enough() -> None:
    text = """
faults:
  - {id: a, fault: bias, target: HIL_SENSOR.xgyro, value: 1}
  - {id: b, preset: sensor-power-failure}
  - {preset: baro-off}
  - {id: c.1, preset: airspeed-blockage}
"""
    schedule = parse_schedule(text)
    assert never_acted(schedule, {"b.1"}) == [
        "a (bias)",
        "baro-off (baro-off)",
        "c.1 (airspeed-blockage)",
    ]
    assert never_acted(schedule, {"a", "b.2", "baro-off.2", "c.1"}) == []
