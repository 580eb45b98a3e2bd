import math
from collections import Counter

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from simvehicle.autopilot.autopilot_link import AutopilotLink
from simvehicle.autopilot.flight_goals import CommandedFlight
from simvehicle.autopilot.mission_service import Missions
from simvehicle.autopilot.parameter_service import Parameters
from simvehicle.autopilot.telemetry import HomePosition
from simvehicle.sensors.readings import BatteryReading, GpsReading
from simvehicle.vehicles.body import Truth


def make_link() -> AutopilotLink:
    parameters, missions = Parameters(), Missions()
    home = HomePosition(47.0, 8.0, 500.0)
    flight = CommandedFlight(parameters, missions, home, lambda lat, lon, alt: np.zeros(3))
    return AutopilotLink(flight, parameters, missions, lambda motor, off: False)


def make_truth(t_us: int) -> Truth:
    yaw = math.radians(-90.0)
    return Truth(
        t_us, math.radians(47.001), math.radians(8.0), 570.0, 520.0, 20.0,
        np.array([111.2, 0.0, -20.0]), np.array([0.0, -5.0, 1.0]),
        np.array([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]), np.array([0.0, 0.0, 0.1]),
        np.array([0.0, 0.0, -9.8]), np.array([5.0, 0.0, 0.0]), np.zeros(3),
        95000.0, 285.0, 1.16, 15.5, 12.0, 0.6,
    )  # fmt: skip


def run(link: AutopilotLink, seconds: float) -> list[dialect.MAVLink_message]:
    frames = []
    for t_us in range(0, round(seconds * 1e6), 4000):
        readings = [BatteryReading(t_us, 15.5, 12.0, 0.6)] if t_us % 1_000_000 == 0 else []
        if t_us % 200_000 == 0:
            fix = GpsReading(t_us, 47.002, 8.0, 521.0, np.zeros(3), 3, 9, 1.2, 2.0)
            frames += link.tick(t_us, make_truth(t_us), [*readings, fix], 0.4)
        else:
            frames += link.tick(t_us, make_truth(t_us), readings, 0.4)
    return dialect.MAVLink(None).parse_buffer(b"".join(frames)) or []


def send(link: AutopilotLink, name: str, *values: object) -> list[dialect.MAVLink_message]:
    mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    message = getattr(mav, name + "_encode")(*values)
    answers = link.received(Frame(message.pack(mav), message_layout(message.get_type())), 4000)
    return dialect.MAVLink(None).parse_buffer(b"".join(answers)) or []


def test_streams_are_sent_at_their_rates() -> None:
    counts = Counter(m.get_type() for m in run(make_link(), 2.0))
    assert counts == {
        "HEARTBEAT": 2, "SYS_STATUS": 4, "ATTITUDE": 40, "ATTITUDE_QUATERNION": 40,
        "GLOBAL_POSITION_INT": 20, "LOCAL_POSITION_NED": 20, "GPS_RAW_INT": 10, "VFR_HUD": 10,
        "ALTITUDE": 10, "HOME_POSITION": 2, "EXTENDED_SYS_STATE": 4, "BATTERY_STATUS": 2,
        "SYSTEM_TIME": 2, "MISSION_CURRENT": 2,
    }  # fmt: skip


def test_telemetry_reports_the_position_of_the_vehicle() -> None:
    last = {m.get_type(): m for m in run(make_link(), 1.5)}
    place = last["GLOBAL_POSITION_INT"]
    assert (place.lat, place.alt, place.relative_alt) == (470010000, 520000, 20000)
    assert (place.vy, place.vz, place.hdg) == (-500, 100, 27000)
    assert last["ATTITUDE"].yaw == pytest.approx(-math.pi / 2, abs=1e-6)
    assert last["LOCAL_POSITION_NED"].z == -20.0
    assert last["GPS_RAW_INT"].lat == 470020000  # the receiver's fix, not the truth
    assert (last["GPS_RAW_INT"].h_acc, last["GPS_RAW_INT"].satellites_visible) == (1200, 9)
    assert last["VFR_HUD"].climb == -1.0
    assert last["BATTERY_STATUS"].current_consumed == 3  # 12 A for a second
    assert last["SYS_STATUS"].onboard_control_sensors_health & 0x10000000  # PREARM_CHECK
    assert last["SYS_STATUS"].onboard_control_sensors_health & 0x100000  # GEOFENCE


def test_the_clock_is_the_one_of_the_hil_link() -> None:
    last = {m.get_type(): m for m in run(make_link(), 1.5)}
    assert last["ATTITUDE"].time_boot_ms == 1000 + 1452  # the first step at or after the due time


def test_timesync_is_answered_once() -> None:
    link = make_link()
    run(link, 0.1)
    (answer,) = send(link, "timesync", 0, 123456789)
    assert (answer.ts1, answer.tc1) == (123456789, 1_096_000_000)
    assert send(link, "timesync", 55, 123456789) == []


def test_file_transfers_are_refused() -> None:
    link = make_link()
    run(link, 0.1)
    request = bytes([0xFF, 0x00, 7, 4, 12, 0, 0, 0, 0, 0, 0, 0]) + b"@PARAM/param" + bytes(227)
    (nak,) = send(link, "file_transfer_protocol", 0, 1, 1, request)
    assert bytes(nak.payload[:6]) == bytes([0x00, 0x01, 7, 129, 1, 4])
    assert nak.payload[12] == 1
    assert nak.target_system == 255


def test_a_requested_data_stream_changes_rates_without_an_answer() -> None:
    link = make_link()
    run(link, 0.1)
    assert send(link, "request_data_stream", 1, 1, 10, 2, 1) == []
    counts = Counter(m.get_type() for m in run(link, 2.0))
    assert counts["ATTITUDE"] == 4


def test_messages_to_other_vehicles_are_ignored() -> None:
    link = make_link()
    run(link, 0.1)
    assert send(link, "param_request_list", 1, 100) == []
    assert send(link, "heartbeat", 6, 8, 0, 0, 4) == []


def test_nothing_is_answered_before_the_first_step() -> None:
    assert send(make_link(), "timesync", 0, 1) == []
