"""What QGroundControl requests from a new vehicle, in its order; every request is answered.

The order is that of QGroundControl's initial connect state machine (version 5): autopilot version,
standard modes, component metadata, parameters, mission, geofence, rally points; older versions
begin with the protocol version. Each question left open costs its user seconds of time-outs.
"""

import struct
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame

ACCEPTED, UNSUPPORTED = 0, 3
REQUEST_MESSAGE = 512


def kinds(messages: list[Any]) -> list[str]:
    return [m.get_type() for m in messages]


def request(station: Any, number: int, *params: float) -> tuple[int, list[Any]]:
    """The result of a command, and the messages sent with its acknowledgement."""
    ack, *rest = station.command(number, *params)
    assert (ack.get_type(), ack.command) == ("COMMAND_ACK", number)
    return ack.result, rest


def test_every_request_of_the_initial_connect_is_answered(station: Any) -> None:
    result, (version,) = request(station, REQUEST_MESSAGE, 148)
    assert (result, version.get_type()) == (ACCEPTED, "AUTOPILOT_VERSION")
    assert version.flight_sw_version >> 24 == 1

    result, modes = request(station, REQUEST_MESSAGE, 435, 0)
    assert result == ACCEPTED
    assert [m.mode_index for m in modes] == [1, 2, 3, 4, 5]  # the last one ends the list
    assert {m.number_modes for m in modes} == {5}

    for metadata in (397, 395):  # then it uses its own copy
        assert request(station, REQUEST_MESSAGE, metadata) == (UNSUPPORTED, [])

    values = station.send("param_request_list", 1, 1)
    assert kinds(values) == ["PARAM_VALUE"] * values[0].param_count
    (again,) = station.send("param_request_read", 1, 1, b"", 3)
    assert (again.param_index, again.param_id) == (3, values[3].param_id)

    for mission_type in (0, 1, 2):
        (count,) = station.send("mission_request_list", 1, 1, mission_type)
        assert (count.get_type(), count.count, count.mission_type) == (
            "MISSION_COUNT", 0, mission_type,
        )  # fmt: skip
        assert station.send("mission_ack", 1, 1, 0, mission_type) == []

    for camera_or_gimbal in (259, 280):
        assert request(station, REQUEST_MESSAGE, camera_or_gimbal) == (UNSUPPORTED, [])
    result, (home,) = request(station, REQUEST_MESSAGE, 242)
    assert (result, home.get_type()) == (ACCEPTED, "HOME_POSITION")


def test_every_listed_mode_can_be_entered_and_is_then_reported(station: Any) -> None:
    _, modes = request(station, REQUEST_MESSAGE, 435, 0)
    station.command(400, 1)
    for mode in modes:
        if mode.mode_name == "Mission":  # no mission is stored yet
            continue
        main, sub = mode.custom_mode >> 16 & 0xFF, mode.custom_mode >> 24
        assert request(station, 176, 1, main, sub)[0] == ACCEPTED
        station.at([0, 0, -5], 0.01)
        _, (now,) = request(station, REQUEST_MESSAGE, 436)
        assert (now.custom_mode, now.standard_mode) == (mode.custom_mode, mode.standard_mode)


def test_a_mode_is_listed_by_its_index_and_none_beyond_the_last(station: Any) -> None:
    _, (second,) = request(station, REQUEST_MESSAGE, 435, 2)
    assert (second.mode_index, second.mode_name) == (2, "Hold")
    assert request(station, REQUEST_MESSAGE, 435, 6) == (UNSUPPORTED, [])


def test_the_protocol_version_is_two(station: Any) -> None:
    for number, param in ((519, 1.0), (REQUEST_MESSAGE, 300.0)):
        command = station.mav.command_long_encode(1, 1, number, 0, param, 0, 0, 0, 0, 0, 0)
        frame = Frame(command.pack(station.mav), message_layout("COMMAND_LONG"))
        ack, version = station.link.received(frame, station.t_us)  # not in pymavlink
        assert station.read([ack])[0].result == ACCEPTED
        assert int.from_bytes(version[7:10], "little") == 300
        assert struct.unpack("<3H", version[10:-2].ljust(6, b"\0")) == (200, 100, 200)
        crc = dialect.x25crc(version[1:-2] + bytes((217,))).crc
        assert int.from_bytes(version[-2:], "little") == crc


def test_file_transfer_is_refused_at_once_so_that_parameters_are_requested(station: Any) -> None:
    (nak,) = station.send("file_transfer_protocol", 0, 1, 1, [1, 0, 0, 4] + [0] * 247)
    assert nak.payload[3:6] == [129, 1, 4]


def test_the_status_says_ready_to_arm(station: Any) -> None:
    sensors = dialect.MAV_SYS_STATUS_PREARM_CHECK | dialect.MAV_SYS_STATUS_GEOFENCE
    (status,) = [m for m in station.at([0, 0, 0], 1.0) if m.get_type() == "SYS_STATUS"]
    for mask in (
        status.onboard_control_sensors_present,
        status.onboard_control_sensors_enabled,
        status.onboard_control_sensors_health,
    ):
        assert mask & sensors == sensors


def test_messages_for_the_display_are_streamed_by_default(station: Any) -> None:
    said = {kind for _ in range(20) for kind in kinds(station.at([0, 0, 0], 0.1))}
    assert said >= {
        "HEARTBEAT", "SYS_STATUS", "ATTITUDE", "GLOBAL_POSITION_INT", "GPS_RAW_INT", "VFR_HUD",
        "HOME_POSITION", "EXTENDED_SYS_STATE", "BATTERY_STATUS", "SYSTEM_TIME",
    }  # fmt: skip
