import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.schedule.triggers import Condition, Telemetry
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame


def frame(name: str, **values: object) -> Frame:
    return Frame(build_frame(message_layout(name), values), message_layout(name))


def telemetry(*frames: Frame) -> Telemetry:
    seen = Telemetry()
    for one in frames:
        seen.note(one)
    return seen


SEEN = telemetry(
    frame("GLOBAL_POSITION_INT", relative_alt=60_000, vz=-200),
    frame("GLOBAL_POSITION_INT", relative_alt=60_000, vz=-200),
    frame("HIL_ACTUATOR_CONTROLS", controls=[0, 0, 0, 0.75]),
    frame("HEARTBEAT", autopilot=12, base_mode=0x81, custom_mode=4 << 16 | 4 << 24),
    frame("HEARTBEAT", autopilot=8, type=6),  # a ground station
)


@pytest.mark.parametrize(
    ("text", "truth"),
    [
        ("GLOBAL_POSITION_INT.relative_alt > 50000", True),
        ("GLOBAL_POSITION_INT.relative_alt > 50000 and not armed", False),
        ("armed or HIL_GPS.alt > 3", True),
        ("altitude_m == 60 and abs(GLOBAL_POSITION_INT.vz) >= 2 * 100", True),
        ("altitude_m == +60 and -altitude_m == -60 and not +altitude_m < 0", True),
        ("HIL_ACTUATOR_CONTROLS.controls[3] > 0.5", True),
        ("0.5 < HIL_ACTUATOR_CONTROLS.controls[3] < 0.7", False),
        ("count(GLOBAL_POSITION_INT) == 2 and count(HIL_GPS) == 0", True),
        ("mode == 'AUTO.MISSION'", True),
        ("mode == 3", False),
        ("HEARTBEAT.base_mode & 128 != 0", True),
        ("GLOBAL_POSITION_INT.vz < -100", True),
        ("HIL_GPS.alt > 0", False),
        ("HIL_GPS.alt <= 0", False),
        ("1 / 0 > 1", False),
    ],
)
def test_conditions_evaluate_as_written(text: str, truth: bool) -> None:
    assert Condition(text).holds(SEEN) is truth


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("__import__('os')", "use abs"),
        ("().__class__", "is not MESSAGE.field"),
        ("armed.real", "is not a message"),
        ("[1, 2]", "not allowed"),
        ("lambda: 1", "not allowed"),
        ("HIL_GPS.alt ** 9", "not allowed"),
        ("armed if armed else armed", "not allowed"),
        ("~altitude_m < 0", "not allowed"),
        ("armed in armed", "another comparison"),
        ("HIL_GPS.altitude > 1", "did you mean"),
        ("HIL_GPSS.alt > 1", "did you mean HIL_GPS"),
        ("HIL_ACTUATOR_CONTROLS.controls[16] > 1", "has no number"),
        ("alarmed", "words are armed"),
        ("armed and", "cannot be read"),
        ("(" * 400, "cannot be read"),
        ("armed " * 100, "longer than"),
    ],
)
def test_any_other_syntax_is_refused(text: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_schedule({"faults": [{"fault": "drop", "when": text}]})
    assert said in str(caught.value)


def run(entry: dict[str, object], heights_m: list[float]) -> list[float]:
    """Return the sent heights, a second apart, with a fault on the altitude."""
    engine = Engine(parse_schedule({"faults": [{"id": "it", **entry}]}))
    found = []
    for i, height_m in enumerate(heights_m):
        values = {"relative_alt": round(height_m * 1000), "alt": 500_000}
        (out,) = engine.apply(
            frame("GLOBAL_POSITION_INT", **values), "from-vehicle", (i + 1) * 1_000_000
        )
        assert isinstance(out.frame, Frame)
        found.append(out.frame.number("alt") / 1000 - 500)
    return found


UP = {"fault": "bias", "target": "GLOBAL_POSITION_INT.alt", "value": 7000, "when": "altitude_m > 5"}
CLIMB = [0.0, 4, 6, 8, 6, 4, 6, 8, 4]


def test_a_condition_starts_a_fault_with_the_frame_that_makes_it_true() -> None:
    assert run({**UP, "for_s": 2}, CLIMB) == [0, 0, 7, 7, 0, 0, 0, 0, 0]


def test_without_a_duration_the_fault_stays_active() -> None:
    assert run(UP, CLIMB) == [0, 0, 7, 7, 7, 7, 7, 7, 7]


def test_a_condition_counts_from_at_s_on() -> None:
    assert run({**UP, "for_s": 1, "at_s": 3.5}, CLIMB) == [0, 0, 0, 0, 7, 0, 0, 0, 0]


def test_a_repeated_fault_starts_each_time_the_condition_becomes_true() -> None:
    again = {**UP, "for_s": 1, "repeat": {"times": 2}}
    assert run(again, [*CLIMB, 6, 4]) == [0, 0, 7, 0, 0, 0, 7, 0, 0, 0, 0]


def test_the_engine_processes_the_messages_of_a_condition() -> None:
    engine = Engine(
        parse_schedule(
            {"faults": [{"fault": "bias", "target": "HIL_GPS.alt", "value": 1, "when": "armed"}]}
        )
    )
    engine.start_at(0)
    assert engine.wanted == {message_layout("HIL_GPS").id, message_layout("HEARTBEAT").id}
