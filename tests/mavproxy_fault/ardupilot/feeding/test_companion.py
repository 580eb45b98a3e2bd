import math

import pytest

from mavproxy_fault.ardupilot.feeding.companion import CompanionFeed
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser


def frame(name, **values):
    layout = message_layout(name)
    return Frame(build_frame(layout, values, seq=9), layout)


def sent(one):
    raw = CompanionFeed().step(one, 0)
    assert raw is not None
    (found,) = Parser().push(raw)
    assert isinstance(found, Frame)
    return found


def test_a_command_passes_unchanged():
    command = frame("COMMAND_LONG", command=400, param1=1)
    assert CompanionFeed().step(command, 0) == command.raw


def test_what_the_bridge_itself_reads_does_not_pass():
    for name in ("HIL_SENSOR", "HIL_STATE_QUATERNION", "HIL_GPS", "TUNNEL"):
        assert CompanionFeed().step(frame(name), 0) is None


def test_a_second_receiver_becomes_gps_input():
    fix = frame("HIL_GPS", id=1, time_usec=604_800_000_000 + 5_000_000, fix_type=3, lat=474_000_000,
                lon=85_000_000, alt=488_000, eph=250, vn=-120, satellites_visible=11)  # fmt: skip
    found = sent(fix)
    assert found.layout.name == "GPS_INPUT"
    assert found.number("gps_id") == 1
    assert found.number("time_week") == 2349
    assert found.number("time_week_ms") == 5_000
    assert found.number("lat") == 474_000_000
    assert found.number("alt") == 488.0
    assert found.number("hdop") == 1.0
    assert round(found.number("vn"), 5) == -1.2


def test_odometry_is_converted_to_the_frame_that_ardupilot_reads():
    odometry = frame("ODOMETRY", frame_id=1, child_frame_id=12, x=1.5)
    found = sent(odometry)
    assert found.number("frame_id") == 20
    assert found.number("x") == 1.5
    already = frame("ODOMETRY", frame_id=20, child_frame_id=12)
    assert CompanionFeed().step(already, 0) == already.raw


@pytest.mark.parametrize(
    ("name", "field"),
    [("ODOMETRY", "pose_covariance"), ("VISION_POSITION_ESTIMATE", "covariance")],
)
def test_an_unknown_attitude_variance_does_not_prevent_arming(name, field):
    covariance = [0.04] * 15 + [math.nan, 0.0, 0.0, math.nan, 0.0, math.nan]
    found = sent(frame(name, **{field: covariance}))
    assert [found.number(field, place) for place in (15, 18, 20)] == [0, 0, 0]
    assert found.number(field, 0) == pytest.approx(0.04)


def test_the_simulators_flow_reaches_ardupilot_as_optical_flow():
    assert sent(frame("HIL_OPTICAL_FLOW", integration_time_us=50_000)).layout.name == "OPTICAL_FLOW"
