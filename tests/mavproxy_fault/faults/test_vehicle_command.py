"""Commands of a schedule: their content for each autopilot, repetition and permission."""

import math
from collections.abc import Iterator
from typing import Any

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.proxy.engine import Engine, refuse_commands
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

PX4, ARDUPILOT = 12, 3
QUAD, PLANE = 2, 1


def message(name: str, component: int = 1, **values: object) -> Frame:
    return Frame(
        build_frame(message_layout(name), values, component=component), message_layout(name)
    )


def heard(
    entry: dict[str, Any], autopilot: int, kind: int, *, answers: int | None = 0, seconds: int = 6
) -> Iterator[tuple[float, Frame]]:
    """Return the commands and their times; the vehicle replies by `answers` (None: never)."""
    engine = Engine(parse_schedule({"faults": [{"fault": "command", **entry}]}))
    for second in range(seconds):
        for frame in (
            message("GLOBAL_POSITION_INT", alt=500_000, relative_alt=12_000),
            message("HEARTBEAT", type=kind, autopilot=autopilot),
            message("HEARTBEAT", component=190, type=6, autopilot=8),
        ):
            for out in engine.apply(frame, "from-vehicle", second * 1_000_000):
                if not out.back:
                    assert out.frame is frame
                    continue
                assert isinstance(out.frame, Frame)
                yield second, out.frame
                if answers is not None:
                    number = int(out.frame.number("command"))
                    ack = message("COMMAND_ACK", command=number, result=answers)
                    engine.apply(ack, "from-vehicle", second * 1_000_000 + 1000)
    engine.finish(seconds * 1_000_000)
    for out in engine.due(seconds * 1_000_000):
        assert isinstance(out.frame, Frame)
        yield seconds, out.frame


def calls(*args: Any, **options: Any) -> list[tuple[float, int]]:
    return [(at, int(frame.number("command"))) for at, frame in heard(*args, **options)]


@pytest.mark.parametrize(
    ("deed", "autopilot", "kind", "asked"),
    [
        ("arm", PX4, QUAD, [(0, 400)]),
        ("disarm", ARDUPILOT, QUAD, [(0, 400)]),
        ("take-off", PX4, QUAD, [(0, 22)]),
        ("take-off", ARDUPILOT, QUAD, [(0, 176), (1, 22)]),
        ("take-off", ARDUPILOT, PLANE, [(0, 176)]),
        ("hold", PX4, QUAD, [(0, 176)]),
        ("hold", ARDUPILOT, QUAD, [(0, 17)]),
        ("return", PX4, PLANE, [(0, 20)]),
        ("land", ARDUPILOT, QUAD, [(0, 21)]),
        ("mission", PX4, QUAD, [(0, 300)]),
    ],
)
def test_each_autopilot_gets_its_own_commands_until_it_accepts(deed, autopilot, kind, asked):
    assert calls({"do": deed}, autopilot, kind) == asked


def test_a_command_without_acceptance_is_repeated_each_second():
    assert calls({"do": "arm"}, PX4, QUAD, answers=4) == [(at, 400) for at in range(6)]
    assert calls({"do": "arm", "for_s": 2.5}, PX4, QUAD, answers=None) == [
        (at, 400) for at in range(3)
    ]


def test_a_label_does_not_end_before_it_begins():
    engine = Engine(parse_schedule({"faults": [{"fault": "command", "do": "arm"}]}))
    beat = message("HEARTBEAT", type=QUAD, autopilot=PX4)
    engine.apply(beat, "from-vehicle", 1_000_000)
    # The reply has no timestamp, and its arrival time is known to some milliseconds.
    engine.apply(message("COMMAND_ACK", command=400), "from-vehicle", 999_000)
    engine.apply(beat, "from-vehicle", 999_500)
    labels = engine.drain_labels()
    assert labels[-1].end_us is not None
    assert all(label.end_us is None or label.end_us >= label.start_us for label in labels)


def test_an_accepted_command_ends_and_the_next_step_follows():
    steps = [
        {"id": "arm", "fault": "command", "do": "arm"},
        {"id": "up", "fault": "command", "do": "take-off", "after": "arm"},
    ]
    engine = Engine(parse_schedule({"faults": steps}))
    active = []
    for second, granted in enumerate((4, 4, 0, 0, 0)):
        heartbeat = message("HEARTBEAT", type=PLANE, autopilot=ARDUPILOT)
        for out in engine.apply(heartbeat, "from-vehicle", second * 1_000_000):
            if out.back and isinstance(out.frame, Frame):
                number = int(out.frame.number("command"))
                ack = message("COMMAND_ACK", command=number, result=granted)
                engine.apply(ack, "from-vehicle", second * 1_000_000 + 1000)
        active.append(engine.active)
    assert active == [["arm"], ["arm"], ["arm"], ["up"], []]


def test_px4_takes_altitude_above_sea_level_and_arducopter_above_ground():
    ((_, px4),) = heard({"do": "take-off", "height_m": 20}, PX4, QUAD)
    assert px4.number("param7") == 508.0  # the field lies at 488 m
    assert math.isnan(px4.number("param4"))
    *_, (_, copter) = heard({"do": "take-off", "height_m": 20}, ARDUPILOT, QUAD)
    assert copter.number("param7") == 20.0


def test_an_auxiliary_function_is_set_and_reset():
    entry = {"number": 218, "params": [65, 2], "afterwards": [65, 0], "for_s": 3}
    found = [
        (at, frame.number("param1"), frame.number("param2"))
        for at, frame in heard(entry, ARDUPILOT, QUAD)
    ]
    assert found == [(0, 65, 2), (3, 65, 0)]


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({}, "needs exactly one of do and number"),
        ({"do": "arm", "number": 400}, "needs exactly one of do and number"),
        ({"do": "fly"}, "do = 'fly'"),
        ({"do": "arm", "params": [1]}, "params and afterwards need number"),
        ({"number": 1, "params": [0] * 8}, "at most seven params"),
        ({"do": "take-off", "height_m": -3}, "height_m = -3 is out of range"),
    ],
)
def test_an_invalid_command_is_refused(keys, reason):
    with pytest.raises(ConfigError, match=reason):
        parse_schedule({"faults": [{"fault": "command", **keys}]})


def test_without_permission_commands_are_refused_in_schedules_and_live():
    schedule = parse_schedule({"faults": [{"id": "up", "fault": "command", "do": "arm"}]})
    with pytest.raises(ConfigError, match=r"up: commands the vehicle.*--allow-commands"):
        Engine(schedule, check=refuse_commands)
    engine = Engine(parse_schedule({"faults": []}), check=refuse_commands)
    with pytest.raises(ConfigError, match="--allow-commands"):
        engine.arm({"fault": "command", "do": "arm"})
    with pytest.raises(ConfigError, match="--allow-commands"):
        engine.replace(schedule)
    assert engine.ids() == []


def test_a_condition_counts_from_the_event_on():
    """Each step of a sequence follows the previous one when its condition is true."""
    text = [
        {"id": "up", "fault": "command", "do": "arm", "at_s": 1, "for_s": 1},
        {"id": "jump", "fault": "bias", "target": "HIL_GPS.lat", "value": 1,
         "after": "up", "when": "HIL_GPS.alt > 5000"},
    ]  # fmt: skip
    engine = Engine(parse_schedule({"faults": text}))
    begun = []
    for second, alt in enumerate((9000, 9000, 1000, 9000, 9000)):
        gps = message("HIL_GPS", component=51, time_usec=second * 1_000_000, alt=alt)
        engine.apply(gps, "to-vehicle", second * 1_000_000)
        begun.append("jump" in engine.active)
    # High at once, but the first step ends at 2 s, where it is low.
    assert begun == [False, False, False, True, True]
