import json
import math
import struct
import time

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.failure_command import FAILURE_UNITS, TYPES, UNITS
from mavproxy_fault.live.rflysim import read_map
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3


def frame(name: str, **values: object) -> Frame:
    return Frame(build_frame(message_layout(name), values, component=51), message_layout(name))


def failure(unit: float, kind: float, instance: float = 0, name: str = "COMMAND_LONG") -> Frame:
    values = {
        "command": 420, "param1": unit, "param2": kind, "param3": instance,
        "target_system": 1, "target_component": 1,
    }  # fmt: skip
    return Frame(
        build_frame(message_layout(name), values, system=255, component=190), message_layout(name)
    )


def failure_with(*params: float, unit: int = 0, kind: int = 4) -> Frame:
    """Send a failure of all instances with params 4 and 5."""
    extra = {f"param{place}": value for place, value in enumerate(params, 4)}
    values = {"command": 420, "param1": unit, "param2": kind, "target_system": 1}
    values |= {"target_component": 1, **extra}
    return Frame(
        build_frame(message_layout("COMMAND_LONG"), values, system=255, component=190),
        message_layout("COMMAND_LONG"),
    )


def control(*passed: str, **options: bool) -> LiveControl:
    engine = Engine(Schedule(1))
    engine.start_at(1_000_000)
    it = LiveControl(engine, **options)
    for name in passed:
        assert it.consume(frame(name), 1_000_000) is None
    return it


def result(it: LiveControl, command: Frame, t_us: int = 2_000_000) -> int:
    replies = it.consume(command, t_us)
    assert replies is not None
    (ack,) = replies
    assert (ack.number("command"), ack.system, ack.component) == (420, 1, 1)
    assert (ack.number("target_system"), ack.number("target_component")) == (255, 190)
    return int(ack.number("result"))


def through(it: LiveControl, one: Frame, t_us: int) -> list[Outgoing]:
    return it.engine.apply(one, "to-vehicle", t_us)


def test_other_commands_are_forwarded() -> None:
    other = frame("COMMAND_LONG", command=400, param1=1)
    assert control().consume(other, 0) is None


def test_a_unit_is_unsupported_until_its_message_is_seen() -> None:
    it = control()
    assert result(it, failure(0, 1)) == UNSUPPORTED
    it.consume(frame("HIL_SENSOR"), 0)
    assert result(it, failure(0, 1)) == ACCEPTED


def test_a_message_is_inspected_only_until_it_is_known() -> None:
    it = control("HIL_SENSOR")
    assert message_layout("HIL_SENSOR").id not in it.wanted
    assert message_layout("COMMAND_LONG").id in it.wanted


def test_failures_are_denied_without_live_control() -> None:
    it = control("HIL_SENSOR", allowed=False)
    assert result(it, failure(0, 1)) == DENIED
    assert it.engine.ids() == []


@pytest.mark.parametrize("name", ["COMMAND_LONG", "COMMAND_INT"])
def test_both_command_messages_are_acknowledged(name: str) -> None:
    assert result(control("HIL_SENSOR"), failure(1, 2, name=name)) == ACCEPTED


@pytest.mark.parametrize("kind", sorted(set(TYPES) - {0}))
@pytest.mark.parametrize("unit", sorted(UNITS))
def test_every_unit_and_type_acts(unit: int, kind: int) -> None:
    """Every message of the unit is changed within two seconds."""
    name = UNITS[unit]
    for part in FAILURE_UNITS[name].parts or [None]:
        message = "ATTITUDE" if part is None else part.message
        passed = "HIL_SENSOR" if part is None else message
        it = control(passed)
        assert result(it, failure(unit, kind)) == ACCEPTED
        acted = False
        fields = message_layout(message).fields
        for i in range(40):
            varying = {
                n: [1 + i % 50] * f.count if f.count else 1 + i % 50
                for n, f in fields.items()
                if f.type != "char" and n not in ("id", message_layout(message).instance)
            }
            if "fields_updated" in fields:
                varying["fields_updated"] = 0x1FFF
            t_us = 2_000_000 + i * 50_000
            one = frame(message, **varying)
            outs = through(it, one, t_us)
            acted |= [(out.frame is one, out.due_us) for out in outs] != [(True, t_us)]
        assert acted, message


def test_instance_two_does_not_affect_instance_one() -> None:
    it = control("HIL_SENSOR")
    result(it, failure(0, 4, 2))
    for id, changed in [(0, False), (1, True)]:
        one = frame("HIL_SENSOR", id=id, xgyro=0.1)
        (out,) = through(it, one, 2_100_000)
        assert (out.frame is not one) is changed


def test_one_motor_stops_and_the_others_run() -> None:
    it = control("HIL_ACTUATOR_CONTROLS")
    result(it, failure(101, 1, 2))
    (out,) = through(it, frame("HIL_ACTUATOR_CONTROLS", controls=[0.5] * 16), 2_100_000)
    assert isinstance(out.frame, Frame)
    assert [out.frame.number("controls", i) for i in range(4)] == [0.5, 0, 0.5, 0.5]
    assert result(it, failure(101, 1, 17)) == UNSUPPORTED


def test_an_esc_that_is_off_stops_its_motor_and_reports_zero_rpm() -> None:
    it = control("HIL_ACTUATOR_CONTROLS", "ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8")
    assert result(it, failure(106, 1, 6)) == ACCEPTED
    cases = {
        "HIL_ACTUATOR_CONTROLS": ("controls", [0.5] * 16, 5),
        "ESC_TELEMETRY_1_TO_4": ("rpm", [5000] * 4, None),
        "ESC_TELEMETRY_5_TO_8": ("rpm", [5000] * 4, 1),
    }
    for message, (field, values, stopped) in cases.items():
        (out,) = through(it, frame(message, **{field: values}), 2_100_000)
        assert isinstance(out.frame, Frame)
        left = [out.frame.number(field, i) for i in range(len(values))]
        assert left == [0 if i == stopped else value for i, value in enumerate(values)]


def test_ok_ends_the_failures_of_its_unit_only() -> None:
    it = control("HIL_SENSOR")
    for unit in (0, 1):
        result(it, failure(unit, 2))
    result(it, failure(0, 2, 1))
    assert result(it, failure(0, 0)) == ACCEPTED
    assert it.engine.ids() == ["mav-accel.1"]


def test_a_second_failure_of_a_unit_replaces_the_first() -> None:
    it = control("HIL_SENSOR")
    result(it, failure(0, 2))
    result(it, failure(0, 3))
    assert [fault["fault"] for fault in it.engine.state()["faults"]] == ["noise"]


@pytest.mark.parametrize(("unit", "kind"), [(50, 1), (0, 99), (float("nan"), 1), (0, float("inf"))])
def test_what_does_not_exist_is_unsupported(unit: float, kind: float) -> None:
    assert result(control("HIL_SENSOR"), failure(unit, kind)) == UNSUPPORTED


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
    with pytest.raises(ConfigError, match="send JSON"):
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
    with pytest.raises(ConfigError, match="value with a number"):  # exceeds a float
        ask(it, "fault/it/value", {"value": 10**400})
    for stamp in ("now", 10**30, -1):
        with pytest.raises(ConfigError, match=f"sent_us = {stamp!r} is not a timestamp"):
            ask(it, "fault/it/value", {"value": 1, "sent_us": stamp})


def test_without_live_control_only_read_only_queries_are_answered() -> None:
    it = control(allowed=False)
    with pytest.raises(ConfigError, match="live control is disabled"):
        ask(it, "fault/it/arm", BIAS)
    assert isinstance(ask(it, "state"), dict)


def test_params_4_and_5_are_a_magnitude_and_a_duration() -> None:
    it = control("HIL_SENSOR")
    assert result(it, failure_with(0.25, 3.0)) == ACCEPTED
    (entry,) = parse_schedule(it.engine.save()).faults
    assert (entry.parameters["value"], entry.for_s) == ([0.25, 0.25, 0.25], 3.0)
    # Omitted or NaN: the defaults of the standard.
    for params in ((), (0.0, 0.0), (math.nan, math.nan)):
        assert result(it, failure_with(*params)) == ACCEPTED
        (entry,) = parse_schedule(it.engine.save()).faults
        assert (entry.parameters["value"], entry.for_s) == ([0.5, 0.5, 0.5], None)


@pytest.mark.parametrize(("kind", "value"), [(4, -0.25), (8, -0.25), (3, 0.25)])
def test_an_offset_and_a_drift_may_be_negative_and_a_noise_has_no_sign(kind, value) -> None:
    it = control("HIL_SENSOR")
    assert result(it, failure_with(-0.25, -3.0, kind=kind)) == ACCEPTED
    (entry,) = parse_schedule(it.engine.save()).faults
    assert (entry.parameters["value"], entry.for_s) == ([value] * 3, None)


def test_param_4_is_the_time_of_a_delay_and_a_slow_sensor() -> None:
    it = control("HIL_SENSOR", "HIL_GPS")
    for kind, message, value in ((6, 4, 2.5), (5, 4, 2.0), (6, 0, 0.25)):
        it.engine.clear("all")
        assert result(it, failure_with(value, unit=message, kind=kind)) == ACCEPTED
        (entry,) = parse_schedule(it.engine.save()).faults
        expected = 1.0 / value if entry.name == "rate-limit" else value
        assert entry.parameters["value"] == expected


def test_failures_are_denied_if_the_vehicle_disables_them() -> None:
    it = control("HIL_SENSOR")
    parameter = frame("PARAM_VALUE", param_id=b"SYS_FAILURE_EN", param_value=0.0)
    assert it.consume(parameter, 1_500_000) is None
    assert result(it, failure(0, 1)) == DENIED
    bytewise = struct.unpack("<f", struct.pack("<i", 1))[0]  # as PX4 sends its integers
    assert (
        it.consume(frame("PARAM_VALUE", param_id=b"SYS_FAILURE_EN", param_value=bytewise), 0)
        is None
    )
    assert result(it, failure(0, 1)) == ACCEPTED
    it.consume(frame("PARAM_VALUE", param_id=b"SYS_FAILURE", param_value=0.0), 0)
    assert result(it, failure(0, 1)) == ACCEPTED
