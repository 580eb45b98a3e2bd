import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3


def test_every_command_gets_exactly_one_acknowledgement(station: Any) -> None:
    for number in dialect.enums["MAV_CMD"]:
        if number > 0xFFFF:
            continue
        for params in ((), (0,) * 7, (1,) * 7):
            acks = [m for m in station.command(number, *params) if m.get_type() == "COMMAND_ACK"]
            assert [(a.command, a.target_system, a.target_component) for a in acks] == [
                (number, 255, 190)
            ]


def test_commands_to_another_vehicle_get_none(station: Any) -> None:
    assert station.send("command_long", 2, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0) == []
    assert not station.flight.armed


def test_a_broadcast_command_is_executed(station: Any) -> None:
    station.send("command_long", 0, 0, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    assert station.flight.armed


def test_disarming_in_the_air_takes_force(station: Any) -> None:
    station.command(400, 1)
    station.at([0, 0, -5])
    assert station.command(400, 0)[0].result == DENIED
    assert station.command(400, 0, 21196)[0].result == ACCEPTED
    assert not station.flight.armed


def test_unsupported_requests_of_qgroundcontrol_are_refused_at_once(station: Any) -> None:
    for number in (395, 397, 280, 259):
        assert station.command(512, number)[0].result == UNSUPPORTED
    assert station.command(521, 1)[0].result == UNSUPPORTED


def test_autopilot_version_announces_supported_capabilities_only(station: Any) -> None:
    ack, version = station.command(512, 148)
    assert ack.result == ACCEPTED
    assert version.capabilities == (
        dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        | dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )


def test_an_interval_is_set_reported_and_stopped(station: Any) -> None:
    assert station.command(511, 30, 100_000)[0].result == ACCEPTED
    _, answer = station.command(510, 30)
    assert (answer.message_id, answer.interval_us) == (30, 100_000)
    station.command(511, 30, -1)
    assert station.command(510, 30)[1].interval_us == -1
    seen = {m.get_type() for _ in range(20) for m in station.at([0, 0, 0], 0.05)}
    assert "ATTITUDE" not in seen
    assert "ATTITUDE_QUATERNION" in seen
    station.command(511, 30, 0)
    assert station.command(510, 30)[1].interval_us == 50_000
    assert station.command(511, 11000, 1000)[0].result == UNSUPPORTED


def test_modes_are_those_of_px4(station: Any) -> None:
    assert station.command(176, 1, 4, 5)[0].result == ACCEPTED
    heartbeat = next(m for m in station.at([0, 0, 0], 1.0) if m.get_type() == "HEARTBEAT")
    assert (heartbeat.custom_mode, heartbeat.autopilot) == (5 << 24 | 4 << 16, 12)
    assert station.command(176, 1, 1, 0)[0].result == DENIED  # manual mode is not supported
    assert station.command(176, 1, 4, 4)[0].result == DENIED  # no mission is stored


def test_reposition_goes_there_once_flying(station: Any) -> None:
    values = (1, 1, 6, 192, 0, 0, -1, 1, 0, math.nan, 473978000, 85456000, 20.0)
    assert station.send("command_int", *values)[0].result == DENIED
    station.command(400, 1)
    station.at([0, 0, -5])
    assert station.send("command_int", *values)[0].result == ACCEPTED
    assert station.flight.goal.r_ned_m[2] == pytest.approx(-20.0)
    assert station.flight.goal.r_ned_m[0] == pytest.approx(6.46, abs=0.05)


def test_failures_are_denied_until_enabled(station: Any) -> None:
    assert station.command(420, 101, 1, 1)[0].result == DENIED
    assert station.failed == []


def test_motor_failures_are_injected_and_others_refused(station: Any) -> None:
    station.send("param_set", 1, 1, b"SYS_FAILURE_EN", 1e-45, 6)
    assert station.command(420, 101, 1, 2)[0].result == ACCEPTED
    assert station.command(420, 101, 0, 0)[0].result == ACCEPTED
    assert station.failed == [(2, True), (0, False)]
    assert station.command(420, 101, 1, math.nan, 0b1001)[0].result == ACCEPTED
    assert station.failed[2:] == [(1, True), (4, True)]
    for nothing in (0, math.nan, -1):
        assert station.command(420, 101, 1, math.nan, nothing)[0].result == DENIED
    assert station.command(420, 101, 1, 9)[0].result == DENIED
    assert station.command(420, 0, 1, 0)[0].result == UNSUPPORTED
    assert station.command(420, 101, 5, 1)[0].result == UNSUPPORTED
