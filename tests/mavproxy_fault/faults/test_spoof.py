import math

import pytest

from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

METRE_DEG = 1 / 111_200  # north, near 47 degrees, to one part in a thousand
LAT, LON = 473_977_418, 85_455_939


def spoofed(name: str, t_s: float, values: dict[str, object], **spoof: object) -> Frame:
    engine = Engine(parse_schedule({"faults": [{"fault": "gps-spoof", **spoof}]}))
    engine.start_at(0)
    frame = Frame(build_frame(message_layout(name), values), message_layout(name))
    (out,) = engine.apply(frame, "to-vehicle", round(t_s * 1e6))
    assert isinstance(out.frame, Frame)
    return out.frame


GPS = {"lat": LAT, "lon": LON, "alt": 488_000, "vn": 300, "ve": 400, "vel": 500, "cog": 5313}


def test_a_jump_moves_the_position_and_leaves_the_velocity() -> None:
    frame = spoofed("HIL_GPS", 1, GPS, offset_m=[200, 0, -10])
    assert (frame.number("lat") - LAT) * 1e-7 == pytest.approx(200 * METRE_DEG, rel=2e-3)
    assert frame.number("lon") == LON
    assert frame.number("alt") == 498_000
    assert (frame.number("vn"), frame.number("vel"), frame.number("cog")) == (300, 500, 5313)


def test_a_ramp_moves_the_velocity_with_the_position() -> None:
    frame = spoofed("HIL_GPS", 10, GPS, offset_m=[200, 0, 0], ramp_s=40)
    assert (frame.number("lat") - LAT) * 1e-7 == pytest.approx(50 * METRE_DEG, rel=2e-3)
    assert (frame.number("vn"), frame.number("ve")) == (800, 400)
    assert frame.number("vel") == round(100 * math.hypot(8, 4))
    assert frame.number("cog") == round(100 * math.degrees(math.atan2(4, 8)))


def test_metres_east_are_more_degrees_at_higher_latitudes() -> None:
    frame = spoofed("HIL_GPS", 1, GPS, offset_m=[0, 100, 0])
    east_deg = (frame.number("lon") - LON) * 1e-7
    assert east_deg == pytest.approx(100 * METRE_DEG / math.cos(math.radians(47.4)), rel=5e-3)


def test_all_messages_have_the_same_position() -> None:
    move = {"offset_m": [120, -80, 15], "velocity_mps": [1, 2, 0]}
    places = {
        name: spoofed(name, 10, {"lat": LAT, "lon": LON, "alt": alt}, **move)
        for name, alt in [
            ("HIL_GPS", 488_000), ("GPS_RAW_INT", 488_000), ("GPS_INPUT", 488.0),
            ("GLOBAL_POSITION_INT", 488_000),
        ]
    }  # fmt: skip
    assert len({(f.number("lat"), f.number("lon")) for f in places.values()}) == 1
    assert {n: f.number("alt") for n, f in places.items()} == {
        "HIL_GPS": 473_000, "GPS_RAW_INT": 473_000, "GPS_INPUT": 473.0,
        "GLOBAL_POSITION_INT": 473_000,
    }  # fmt: skip


def test_unknown_speed_and_course_stay_unknown() -> None:
    values = {**GPS, "vel": 65535, "cog": 65535}
    frame = spoofed("HIL_GPS", 1, values, velocity_mps=[1, 0, 0])
    assert (frame.number("vel"), frame.number("cog")) == (65535, 65535)
    assert frame.number("vn") == 400


def test_gps_raw_int_shows_the_velocity_by_speed_and_course() -> None:
    frame = spoofed("GPS_RAW_INT", 1, {"lat": LAT, "vel": 300, "cog": 0}, velocity_mps=[0, 4, 0])
    assert (frame.number("vel"), frame.number("cog")) == (500, 5313)


def test_odometry_rotates_the_velocity_to_body_axes() -> None:
    half = math.sqrt(0.5)
    values = {"q": [half, 0, 0, half], "frame_id": 1, "child_frame_id": 12, "x": 5.0}
    frame = spoofed("ODOMETRY", 2, values, velocity_mps=[3, 0, 0])  # heading east
    assert frame.number("x") == pytest.approx(11)
    moved = [frame.number(name) for name in ("vx", "vy", "vz")]
    assert moved == pytest.approx([0, -3, 0], abs=1e-6)


def test_visual_odometry_is_not_moved() -> None:
    values = {"x": 5.0, "frame_id": 1, "estimator_type": 2}
    frame = spoofed("ODOMETRY", 2, values, offset_m=[9, 0, 0])
    assert frame.number("x") == 5.0


def test_odometry_in_a_frame_of_unknown_heading_is_not_moved() -> None:
    frame = spoofed("ODOMETRY", 2, {"x": 5.0, "frame_id": 20}, offset_m=[9, 0, 0])
    assert frame.number("x") == 5


def test_a_position_wraps_at_the_date_line() -> None:
    frame = spoofed("HIL_GPS", 1, {"lat": 0, "lon": 1_799_999_999}, offset_m=[0, 1000, 0])
    assert -1_800_000_000 <= frame.number("lon") < -1_799_900_000


def test_the_magnitude_of_the_label_is_in_metres() -> None:
    engine = Engine(parse_schedule({"faults": [{"preset": "gps-spoof", "for_s": 60}]}))
    layout = message_layout("HIL_GPS")
    for i in range(700):
        engine.apply(Frame(build_frame(layout, GPS), layout), "to-vehicle", i * 100_000)
    label = engine.drain_labels()[-1]
    assert (label.preset, label.magnitude) == ("gps-spoof", pytest.approx(200))
