import functools
import itertools
import json
import struct
import time
from collections.abc import Sequence

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.failure_command import (
    FAILURE_UNITS,
    PARTS,
    TYPES,
    UNITS,
)
from mavproxy_fault.live.rflysim import read_map
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.senders import LINKS, new_senders
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3
NAN = float("nan")
INSTANCES = (1, 2, 3)  # of the simulated sensors


def frame(name: str, **values: object) -> Frame:
    return Frame(build_frame(message_layout(name), values, component=51), message_layout(name))


def failure(
    unit: float, kind: float, instance: float = 0, mask: float = 0.0, name: str = "COMMAND_LONG",
    **more: float,
) -> Frame:  # fmt: skip
    values = {
        "command": 420, "param1": unit, "param2": kind, "param3": instance, "param4": mask,
        "target_system": 1, "target_component": 1, **more,
    }  # fmt: skip
    return Frame(
        build_frame(message_layout(name), values, system=255, component=190), message_layout(name)
    )


@functools.cache
def healthy(name: str, instance: int, i: int) -> Frame:
    """A frame of a sensor whose values vary."""
    field = message_layout(name).instance
    values: dict[str, object] = {
        n: [1 + i % 50] * f.count if f.count else 1 + i % 50
        for n, f in message_layout(name).fields.items()
        if f.type != "char"
    }
    values |= {"fields_updated": 0x1FFF} if "fields_updated" in values else {}
    return frame(name, **values | ({field: instance - 1} if field else {}))


def control(*passed: str, vehicles: Sequence[int] = (1,), **options: bool) -> LiveControl:
    engine = Engine(Schedule(1))
    engine.start_at(1_000_000)
    it = LiveControl(engine, **options)
    it.senders = new_senders()
    for system in vehicles:
        it.senders[LINKS + (system << 8 | 1)] = 1
    for name in passed:
        for instance in INSTANCES:
            assert it.consume(healthy(name, instance, 0), "to-vehicle", 1_000_000) is None
    return it


def result(it: LiveControl, command: Frame, t_us: int = 2_000_000) -> int | None:
    """The result of the reply; None if the command was forwarded."""
    replies = it.consume(command, "to-vehicle", t_us)
    if replies is None:
        return None
    (ack,) = replies
    assert (ack.number("command"), ack.system, ack.component) == (420, 1, 1)
    assert (ack.number("target_system"), ack.number("target_component")) == (255, 190)
    return int(ack.number("result"))


def acknowledge(it: LiveControl, code: int, t_us: int) -> None:
    """The autopilot's own reply passes."""
    values = {"command": 420, "result": code, "target_system": 255, "target_component": 190}
    layout = message_layout("COMMAND_ACK")
    ack = Frame(build_frame(layout, values, system=1, component=1), layout)
    assert it.consume(ack, "from-vehicle", t_us) is None


def through(it: LiveControl, one: Frame, t_us: int) -> list[Outgoing]:
    return it.engine.apply(one, "to-vehicle", t_us)


def affected(it: LiveControl, name: str) -> set[int]:
    """The instances whose frames are changed, late or missing within two seconds."""
    found = set()
    for i in range(40):
        for instance in INSTANCES:
            t_us = 2_000_000 + i * 50_000
            one = healthy(name, instance, i)
            outs = through(it, one, t_us)
            if [(out.frame is one, out.due_us) for out in outs] != [(True, t_us)]:
                found.add(instance)
    return found


def test_other_commands_are_forwarded() -> None:
    other = frame("COMMAND_LONG", command=400, param1=1)
    assert control().consume(other, "to-vehicle", 0) is None


def test_a_failure_is_left_to_the_autopilot_until_its_message_is_heard() -> None:
    it = control()
    assert result(it, failure(0, 1)) is None
    it.consume(healthy("HIL_SENSOR", 1, 0), "to-vehicle", 0)
    assert result(it, failure(0, 1)) == ACCEPTED


def test_a_message_is_inspected_only_until_its_instances_are_known() -> None:
    it = control("HIL_SENSOR")
    assert message_layout("HIL_SENSOR").id in it.wanted
    it.consume(healthy("HIL_SENSOR", 1, 0), "to-vehicle", 3_000_001)
    assert message_layout("HIL_SENSOR").id not in it.wanted
    assert message_layout("COMMAND_LONG").id in it.wanted


def test_a_clock_that_goes_back_does_not_prolong_the_inspection() -> None:
    it = control()
    for t_us in (1_700_000_000_000_000, 1_000_000, 3_000_001):
        it.consume(healthy("HIL_SENSOR", 1, 0), "to-vehicle", t_us)
    assert message_layout("HIL_SENSOR").id not in it.wanted


def test_without_live_control_the_command_is_forwarded() -> None:
    it = control("HIL_SENSOR", allowed=False)
    assert result(it, failure(0, 1)) is None
    assert it.engine.ids() == []


@pytest.mark.parametrize("name", ["COMMAND_LONG", "COMMAND_INT"])
def test_both_command_messages_are_acknowledged(name: str) -> None:
    assert result(control("HIL_SENSOR"), failure(1, 2, name=name)) == ACCEPTED


@pytest.mark.parametrize("kind", sorted(set(TYPES) - {0}))
@pytest.mark.parametrize("unit", sorted(UNITS))
def test_every_unit_and_type_acts_on_the_addressed_instances_only(unit: int, kind: int) -> None:
    parts = FAILURE_UNITS[UNITS[unit]].parts if UNITS[unit] in FAILURE_UNITS else ()
    # What is addressed does not depend on the type: every bitmask is tried with one of them.
    masks = range(8) if kind == 1 else (0, 5)
    for part, mask in itertools.product(parts, masks):
        it = control(part.message)
        command = failure(unit, kind, NAN, mask) if mask else failure(unit, kind, 0)
        chosen = {n for n in INSTANCES if mask >> n - 1 & 1} or set(INSTANCES)
        if not message_layout(part.message).instance and not part.indexed and chosen - {1} and mask:
            assert result(it, command) is None  # that message has one instance only
            assert affected(it, part.message) == set()
            continue
        assert result(it, command) == ACCEPTED
        alone = part.indexed or not message_layout(part.message).instance
        assert affected(it, part.message) == (set(INSTANCES) if alone else chosen), mask
        assert result(it, failure(unit, 0)) == ACCEPTED
        assert it.engine.ids() == []


@pytest.mark.parametrize("kind", sorted(set(TYPES) - {0}))
@pytest.mark.parametrize("unit", [105, 108])
def test_a_failure_of_the_link_acts_on_every_message(unit: int, kind: int) -> None:
    it = control()
    assert result(it, failure(unit, kind)) == ACCEPTED
    assert affected(it, "ATTITUDE") == set(INSTANCES)


@pytest.mark.parametrize("unit", [106, 109, 110, 50, NAN])
def test_what_no_message_carries_is_left_to_the_autopilot(unit: float) -> None:
    assert result(control(*PARTS), failure(unit, 1)) is None


def test_one_motor_stops_and_the_others_run() -> None:
    it = control("HIL_ACTUATOR_CONTROLS")
    result(it, failure(101, 1, NAN, 0b1010))
    (out,) = through(it, frame("HIL_ACTUATOR_CONTROLS", controls=[0.5] * 16), 2_100_000)
    assert isinstance(out.frame, Frame)
    assert [out.frame.number("controls", i) for i in range(5)] == [0.5, 0, 0.5, 0, 0.5]
    assert result(it, failure(101, 1, 17)) is None


def test_all_ones_are_all_instances() -> None:
    it = control("HIL_SENSOR")
    assert result(it, failure(0, 4, NAN, 0xFFFF)) == ACCEPTED
    assert it.engine.ids() == ["mav-gyro.1"]


@pytest.mark.parametrize(
    "command",
    [
        failure(0, 1, NAN, NAN), failure(0, 1, NAN, 0), failure(0, 1, NAN, -1),
        failure(0, 1, NAN, 1.5), failure(0, 1, -1), failure(0, 1, 1.5),
        failure(0, 1, float("inf")), failure(0, 4, 0, 0, param5=3.0), failure(0, 1, param7=1),
        failure(0, 1, name="COMMAND_INT", x=5),
    ],
)  # fmt: skip
def test_parameters_against_the_standard_are_denied(command: Frame) -> None:
    it = control("HIL_SENSOR")
    assert result(it, command) == DENIED
    assert it.engine.ids() == []


def test_the_instance_precedes_the_bitmask() -> None:
    it = control("HIL_SENSOR")
    result(it, failure(0, 1, 2, 0b101))
    assert affected(it, "HIL_SENSOR") == {2}


def test_an_instance_that_was_not_heard_is_left_to_the_autopilot_and_looked_for() -> None:
    it = control("HIL_SENSOR")
    it.consume(healthy("HIL_SENSOR", 1, 0), "to-vehicle", 4_000_000)
    assert result(it, failure(0, 1, 4), 5_000_000) is None
    assert result(it, failure(0, 1, NAN, 0b1001), 5_000_000) is None
    it.consume(healthy("HIL_SENSOR", 4, 0), "to-vehicle", 5_100_000)
    assert result(it, failure(0, 1, 4), 5_200_000) == ACCEPTED


def test_a_sensor_without_its_update_flags_was_not_heard() -> None:
    it = control()
    it.consume(frame("HIL_SENSOR", fields_updated=0x38), "to-vehicle", 1_000_000)
    assert result(it, failure(0, 1)) == ACCEPTED
    assert result(it, failure(3, 1)) is None


@pytest.mark.parametrize("target", [{"target_component": 5}, {"target_system": 7}])
def test_nothing_is_answered_for_a_component_that_was_not_heard(target: dict[str, float]) -> None:
    assert result(control("HIL_SENSOR"), failure(0, 1, **target)) is None


def test_a_simulator_alone_is_no_autopilot() -> None:
    assert result(control("HIL_SENSOR", vehicles=()), failure(0, 1)) is None


def test_signed_frames_that_cannot_be_changed_are_not_ours() -> None:
    it = control()
    it.consume(healthy("HIL_SENSOR", 1, 0), "to-vehicle", 1_000_000, sealed=True)
    assert result(it, failure(0, 1)) is None


@pytest.mark.parametrize("name", ["ODOMETRY", "DISTANCE_SENSOR", "BATTERY_STATUS"])
def test_telemetry_of_the_vehicle_is_not_its_sensor(name: str) -> None:
    unit = next(n for n, unit in UNITS.items() if PARTS[name][0] in FAILURE_UNITS[unit].parts)
    it = control()
    it.consume(healthy(name, 1, 0), "from-vehicle", 1_000_000)
    assert result(it, failure(unit, 1)) is None
    it.consume(healthy(name, 1, 0), "to-vehicle", 1_000_000)
    assert result(it, failure(unit, 1)) == ACCEPTED
    one = healthy(name, 1, 0)
    assert [out.frame for out in it.engine.apply(one, "from-vehicle", 2_100_000)] == [one]


def test_a_failure_of_one_vehicle_leaves_the_other_alone() -> None:
    it = control("HIL_SENSOR", vehicles=(1, 2))
    assert result(it, failure(0, 1)) == ACCEPTED
    other = Frame(
        build_frame(message_layout("HIL_SENSOR"), {"fields_updated": 63}, system=2, component=51),
        message_layout("HIL_SENSOR"),
    )
    assert [out.frame for out in through(it, other, 2_100_000)] == [other]
    assert affected(it, "HIL_SENSOR") == set(INSTANCES)
    assert result(it, failure(0, 1, target_system=2)) is None  # its sensors do not pass here


def test_what_a_simulator_sends_under_another_system_may_be_for_any_of_several_vehicles() -> None:
    for vehicles, expected in (((1,), ACCEPTED), ((1, 2), None)):
        it = control(vehicles=vehicles)
        raw = build_frame(message_layout("HIL_SENSOR"), {"fields_updated": 63}, system=42)
        it.consume(Frame(raw, message_layout("HIL_SENSOR")), "to-vehicle", 1_000_000)
        assert result(it, failure(0, 1)) == expected


def test_a_broadcast_fails_every_vehicle_or_is_left_to_them() -> None:
    it = control("HIL_SENSOR", vehicles=(1, 2))
    everyone = failure(0, 1, target_system=0)
    assert it.consume(everyone, "to-vehicle", 1_500_000) is None  # nothing for vehicle 2 was heard
    raw = build_frame(message_layout("HIL_SENSOR"), {"fields_updated": 63}, system=2)
    other = Frame(raw, message_layout("HIL_SENSOR"))
    it.consume(other, "to-vehicle", 1_600_000)
    replies = it.consume(everyone, "to-vehicle", 1_700_000)
    assert replies is not None
    assert [(ack.system, ack.number("result")) for ack in replies] == [(1, 0), (2, 0)]
    assert it.engine.ids() == ["mav-gyro.1", "mav2-gyro.1"]
    assert [out.frame for out in through(it, other, 2_100_000)] != [other]


def test_a_station_is_not_another_vehicle() -> None:
    it = control(vehicles=(1, 255))
    raw = build_frame(message_layout("HIL_SENSOR"), {"fields_updated": 63}, system=42)
    it.consume(Frame(raw, message_layout("HIL_SENSOR")), "to-vehicle", 1_000_000)
    assert result(it, failure(0, 1)) == ACCEPTED


def test_a_signed_command_of_an_unknown_key_is_left_to_the_autopilot() -> None:
    it = control("HIL_SENSOR")
    assert it.consume(failure(0, 1), "to-vehicle", 1_000_000, sealed=True) is None
    assert it.engine.ids() == []


@pytest.mark.parametrize("kind", [9, 77, NAN, -1])
@pytest.mark.parametrize("unit", [0, 101, 105, 108])
def test_an_unknown_type_is_left_to_the_autopilot(unit: int, kind: float) -> None:
    assert result(control(*PARTS), failure(unit, kind)) is None


def test_a_unit_that_was_not_heard_is_looked_for_after_a_command() -> None:
    it = control()
    it.consume(frame("HIL_SENSOR", fields_updated=0x3F), "to-vehicle", 1_000_000)
    it.consume(frame("HIL_SENSOR", fields_updated=0x3F), "to-vehicle", 4_000_000)  # the last one
    assert message_layout("HIL_SENSOR").id not in it.wanted
    assert result(it, failure(2, 1), 5_000_000) is None
    slower = frame("HIL_SENSOR", fields_updated=0x1C0)
    it.consume(slower, "to-vehicle", 5_500_000)
    assert result(it, failure(2, 1), 6_000_000) == ACCEPTED


def test_a_command_by_mavlink_1_is_read_and_answered() -> None:
    from pymavlink.dialects.v20 import all as judge

    sender = judge.MAVLink(None, 255, 190)
    command = judge.MAVLink_command_long_message(1, 1, 420, 0, 0, 1, NAN, 2, 0, 0, 0)
    raw = bytes(command.pack(sender, force_mavlink1=True))
    it = control("HIL_SENSOR")
    assert result(it, Frame(raw, message_layout("COMMAND_LONG"))) == ACCEPTED
    assert affected(it, "HIL_SENSOR") == {2}


def test_a_command_int_may_leave_out_its_coordinates() -> None:
    it = control("HIL_SENSOR")
    command = failure(0, 1, 2, NAN, "COMMAND_INT", x=0x7FFFFFFF, y=0x7FFFFFFF, z=NAN)
    assert result(it, command) == ACCEPTED
    assert affected(it, "HIL_SENSOR") == {2}


def test_ok_ends_the_failures_of_its_unit_only() -> None:
    it = control("HIL_SENSOR")
    for unit in (0, 1):
        result(it, failure(unit, 2))
    result(it, failure(0, 2, 1))
    assert result(it, failure(0, 0)) == ACCEPTED
    assert it.engine.ids() == ["mav-accel.1"]


def test_ok_for_one_instance_leaves_the_failure_of_the_others() -> None:
    it = control("HIL_SENSOR")
    result(it, failure(0, 4))
    result(it, failure(0, 0, 2))
    assert affected(it, "HIL_SENSOR") == {1, 3}


def test_a_second_failure_of_a_unit_replaces_the_first() -> None:
    it = control("HIL_SENSOR")
    result(it, failure(0, 2, 3))
    result(it, failure(0, 2))
    result(it, failure(0, 3))
    assert [fault["fault"] for fault in it.engine.state()["faults"]] == ["noise"]


def test_a_failure_that_the_autopilot_accepts_is_labelled_as_its_own() -> None:
    it = control()
    result(it, failure(0, 1, 2), 2_000_000)
    acknowledge(it, 5, 2_050_000)  # in progress
    assert it.engine.drain_labels() == []
    acknowledge(it, ACCEPTED, 2_100_000)
    (label,) = it.engine.drain_labels()
    assert (label.id, label.fault, label.by) == ("autopilot1-gyro-2", "gyro-off", "autopilot")
    assert (label.start_us, label.end_us) == (2_000_000, None)
    assert label.targets == ("SCALED_IMU2.xgyro", "SCALED_IMU2.ygyro", "SCALED_IMU2.zgyro")
    acknowledge(it, ACCEPTED, 2_200_000)  # repeated
    assert it.engine.drain_labels() == []
    result(it, failure(0, 0), 5_000_000)
    acknowledge(it, ACCEPTED, 5_100_000)
    (label,) = it.engine.drain_labels()
    assert (label.id, label.end_us) == ("autopilot1-gyro-2", 5_100_000)


def test_a_repeated_command_is_labelled_once() -> None:
    it = control()
    for i in range(3):  # the reply is late, and the station asks again
        result(it, failure(0, 1, 2, confirmation=i), 2_000_000 + i * 500_000)
    acknowledge(it, ACCEPTED, 3_100_000)
    assert len(it.engine.drain_labels()) == 1
    acknowledge(it, ACCEPTED, 3_200_000)
    assert it.engine.drain_labels() == []


def test_a_reply_that_never_came_is_not_that_of_a_later_command() -> None:
    it = control()
    result(it, failure(0, 1), 2_000_000)
    result(it, failure(2, 2), 9_000_000)
    acknowledge(it, ACCEPTED, 9_100_000)
    assert [label.fault for label in it.engine.drain_labels()] == ["mag-stuck"]


def test_two_stations_have_their_own_replies() -> None:
    it = control()
    other = failure(1, 2)
    raw = bytearray(other.raw)
    raw[5], raw[6] = 254, 190
    it.consume(Frame(bytes(raw), other.layout), "to-vehicle", 2_000_000)
    result(it, failure(0, 1), 2_010_000)
    acknowledge(it, ACCEPTED, 2_100_000)
    assert [label.fault for label in it.engine.drain_labels()] == ["gyro-off"]


def test_every_vehicle_of_a_broadcast_has_its_label() -> None:
    it = control(vehicles=(1, 2))
    assert it.consume(failure(0, 1, target_system=0), "to-vehicle", 2_000_000) is None
    layout = message_layout("COMMAND_ACK")
    for system in (1, 2):
        values = {"command": 420, "result": ACCEPTED, "target_system": 255, "target_component": 190}
        ack = Frame(build_frame(layout, values, system=system), layout)
        it.consume(ack, "from-vehicle", 2_100_000)
    ids = [label.id for label in it.engine.drain_labels()]
    assert ids == ["autopilot1-gyro", "autopilot2-gyro"]


def test_a_failure_that_the_autopilot_refuses_has_no_label() -> None:
    it = control()
    result(it, failure(101, 1, 2))
    acknowledge(it, UNSUPPORTED, 2_100_000)
    assert it.engine.drain_labels() == []


def test_the_label_of_the_autopilot_s_failure_ends_with_the_session() -> None:
    it = control()
    result(it, failure(101, 1, 2))
    acknowledge(it, ACCEPTED, 2_100_000)
    first, last = it.engine.drain_labels(), it.engine.finish(9_000_000)
    assert [label.targets for label in first] == [("HIL_ACTUATOR_CONTROLS.controls[1]",)]
    assert [label.end_us for label in last] == [9_000_000]


def rflysim(ids: list[int], floats: list[float], checksum: int = 1234567897) -> bytes:
    slots, numbers = ids + [0] * (8 - len(ids)), floats + [0.0] * (20 - len(floats))
    return struct.pack("<10i20f", checksum, 1, *slots, *numbers)


def test_rflysim_motor_faults_scale_the_commands_and_repeats_name_more_motors() -> None:
    it = control()
    it.rflysim = read_map()
    it.packet(rflysim([123450, 123450], [0.8, 0.9, 0.5, 1.0]), 2_000_000)
    (out,) = through(it, frame("HIL_ACTUATOR_CONTROLS", controls=[1.0] * 16), 2_000_000)
    assert isinstance(out.frame, Frame)
    assert [out.frame.number("controls", i) for i in range(5)] == pytest.approx(
        [0.8, 0.9, 0.5, 1, 1]
    )


def test_an_rflysim_fault_latches_until_no_fault_comes() -> None:
    it = control()
    it.rflysim = read_map()
    it.packet(rflysim([123455], [4, 1.5]), 2_000_000)
    it.packet(rflysim([123450], [0.5]), 2_100_000)
    assert len(it.engine.ids()) == 3
    it.packet(rflysim([123549], []), 2_200_000)
    assert it.engine.ids() == []


def test_an_rflysim_sensor_fault_has_a_bias_per_axis() -> None:
    it = control()
    it.rflysim = read_map()
    it.packet(rflysim([123452] * 4, [3, 2.0, 0.0, -1.0, 0.0, 0.5, 0.0]), 2_000_000)
    biases = {
        fault["targets"][0]: fault["parameters"]["value"]
        for fault in it.engine.state()["faults"]
        if fault["fault"] == "bias"
    }
    assert biases == {"HIL_SENSOR.xacc": 2, "HIL_SENSOR.yacc": -1, "HIL_SENSOR.zacc": 0.5}


@pytest.mark.parametrize("data", [b"", bytes(120), rflysim([123450], [0.5], 1234567800)])
def test_other_datagrams_on_rflysim_s_port_do_nothing(data: bytes) -> None:
    it = control()
    it.rflysim = read_map()
    assert it.packet(data, 2_000_000) == []


@pytest.mark.parametrize("ids_first", [True, False])
def test_an_rflysim_packet_without_its_head_is_read_in_both_orders(ids_first: bool) -> None:
    it = control()
    it.rflysim = read_map()
    ids, floats = [123450] + [0] * 7, [0.5, 1.0] + [0.0] * 18
    bare = struct.pack("<8i20f", *ids, *floats) if ids_first else struct.pack(
        "<20f8i", *floats, *ids
    )  # fmt: skip
    assert it.packet(bare, 2_000_000) == ["rflysim-1-123450.1", "rflysim-1-123450.2"]


def test_an_unknown_datagram_is_named_once_by_its_size(caplog: pytest.LogCaptureFixture) -> None:
    it = control()
    it.rflysim = read_map()
    for data in (bytes(112), bytes(112), b"other"):
        assert it.packet(data, 2_000_000) == []
    assert [record.getMessage() for record in caplog.records] == [
        "RflySim: a datagram of 112 bytes is no fault packet; ignored",
        "RflySim: a datagram of 5 bytes is no fault packet; ignored",
    ]


def ask(it: LiveControl, what: str, payload: object = None) -> object:
    data = payload.encode() if isinstance(payload, str) else json.dumps(payload).encode()
    return it.answer(f"mavfault/v1/live/@ctl/{what}", data, 5_000_000)


BIAS = {"fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 1, "for_s": 2}


def test_a_query_arms_changes_and_ends_a_fault() -> None:
    it = control()
    assert ask(it, "fault/it/arm", BIAS) == {"armed": ["it"]}
    (out,) = through(it, frame("HIL_SENSOR"), 6_900_000)  # armed at 5 s, for two
    assert isinstance(out.frame, Frame)
    assert out.frame.number("xgyro") == 1
    ask(it, "fault/it/value", {"value": 3})
    (out,) = through(it, frame("HIL_SENSOR"), 6_950_000)
    assert isinstance(out.frame, Frame)
    assert out.frame.number("xgyro") == 3
    assert ask(it, "fault/it/disarm") == {"cleared": "it"}
    assert it.engine.ids() == []


def test_a_schedule_is_loaded_saved_and_stopped() -> None:
    it = control()
    ask(it, "schedule/load", json.dumps({"seed": 1, "faults": [{"id": "a", **BIAS}]}))
    saved = ask(it, "schedule/save")
    assert isinstance(saved, dict)
    assert [entry.id for entry in parse_schedule(saved["yaml"]).faults] == ["a"]
    ask(it, "schedule/stop")
    assert it.engine.ids() == []


def test_a_schedule_saved_for_begin_starts_at_once() -> None:
    it = control()
    it.engine.advance_time(9_000_000)
    ask(it, "fault/a/arm", {**BIAS, "for_s": 2})
    saved = ask(it, "schedule/save")
    it.engine.advance_time(20_000_000)
    assert ask(it, "schedule/begin", saved["anew"]) == {"faults": ["a"]}
    (fault,) = it.engine.state()["faults"]
    assert (fault["state"], fault["start_us"]) == ("active", 20_000_000)


def test_an_invalid_schedule_does_not_replace_the_running_one() -> None:
    it = control()
    ask(it, "fault/it/arm", BIAS)
    with pytest.raises(ConfigError, match=r"schedule/load:2: .*did you mean bias"):
        ask(it, "schedule/load", "faults:\n  - {fault: bais}\n")
    assert it.engine.ids() == ["it"]


@pytest.mark.parametrize(
    ("what", "payload"),
    [
        ("fault/it/arm", {"fault": "bais"}),
        ("fault/it/arm", [1]),
        ("fault/it/disarm", None),
        ("fault/it/value", {"value": "much"}),
        ("fault/a/b/arm", {"fault": "drop", "target": "HIL_GPS"}),
        ("fault/it/explode", {}),
        ("schedule/lod", ""),
    ],
)
def test_a_wrong_query_is_refused(what: str, payload: object) -> None:
    with pytest.raises(ConfigError):
        ask(control(), what, payload)


def test_deeply_nested_lists_are_refused() -> None:
    nested = b'{"fault": ' + b"[" * 5000 + b"]" * 5000 + b"}"
    # Python 3.14 reads them, and then they are no fault.
    with pytest.raises(ConfigError, match=r"send JSON|does not fit"):
        control().answer("mavfault/v1/live/@ctl/fault/a/arm", nested, 5_000_000)


def test_the_latency_of_a_streamed_value_ends_when_it_acts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    it = control()
    streamed = {**BIAS, "profile": {"live": {"timeout_s": 2}}}
    del streamed["value"]
    ask(it, "fault/it/arm", streamed)
    act = it.prepare("mavfault/v1/live/@ctl/fault/it/value", b'{"value": 1, "sent_us": 1000000}')
    monkeypatch.setattr(time, "time_ns", lambda: 1_250_000_000)
    act(5_000_000)
    (state,) = it.engine.state()["faults"]
    assert state["latency_us"] == 250_000


@pytest.mark.parametrize("action", ["arm", "value"])
def test_a_payload_that_is_not_text_is_refused(action: str) -> None:
    with pytest.raises(ConfigError, match="send JSON"):
        control().answer(f"mavfault/v1/live/@ctl/fault/a/{action}", b'{"\x88": 1}', 5_000_000)


def test_a_payload_that_is_too_large_is_always_refused() -> None:
    with pytest.raises(ConfigError, match="at most 8 MB are read"):
        control().answer("mavfault/v1/live/@ctl/schedule/stop", b" " * (8 << 20 | 1), 5_000_000)


def test_a_streamed_value_needs_a_number_and_a_timestamp() -> None:
    it = control()
    streamed = {**BIAS, "profile": {"live": {"timeout_s": 2}}}
    del streamed["value"]
    ask(it, "fault/it/arm", streamed)
    with pytest.raises(ConfigError, match="Number out of range"):  # exceeds a float
        ask(it, "fault/it/value", {"value": 10**400})
    for stamp in ("now", 10**30, -1):
        with pytest.raises(ConfigError, match=r"Expected `int.*`\$.sent_us`; send JSON"):
            ask(it, "fault/it/value", {"value": 1, "sent_us": stamp})


def test_without_live_control_only_read_only_queries_are_answered() -> None:
    it = control(allowed=False)
    with pytest.raises(ConfigError, match="live control is disabled"):
        ask(it, "fault/it/arm", BIAS)
    assert isinstance(ask(it, "state"), dict)


def test_failures_are_left_to_a_vehicle_that_disables_them() -> None:
    it = control("HIL_SENSOR")
    parameter = frame("PARAM_VALUE", param_id=b"SYS_FAILURE_EN", param_value=0.0)
    assert it.consume(parameter, "from-vehicle", 1_500_000) is None
    assert result(it, failure(0, 1)) is None
    bytewise = struct.unpack("<f", struct.pack("<i", 1))[0]  # as PX4 sends its integers
    enabled = frame("PARAM_VALUE", param_id=b"SYS_FAILURE_EN", param_value=bytewise)
    assert it.consume(enabled, "from-vehicle", 0) is None
    assert result(it, failure(0, 1)) == ACCEPTED
    other = frame("PARAM_VALUE", param_id=b"SYS_FAILURE", param_value=0.0)
    it.consume(other, "from-vehicle", 0)
    assert result(it, failure(0, 1)) == ACCEPTED
