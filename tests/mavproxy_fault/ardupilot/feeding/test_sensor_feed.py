import json
import struct

import pytest

from mavproxy_fault.ardupilot.feeding.sensor_feed import SensorFeed
from mavproxy_fault.ardupilot.feeding.vectornav import BinaryOutput
from mavproxy_fault.ardupilot.hil_readings import Readings, TrueState
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

HOME = TrueState(0, (1.0, 0.0, 0.0, 0.0), 474_000_000, 85_000_000, 488_000, (0.0, 0.0, 0.0))
IMU_BYTES, GNSS_BYTES, INS_BYTES = 82, 110, 104
OUTPUTS = (
    BinaryOutput(0x01, [0x0721]),
    BinaryOutput(0x31, [0x0001, 0x0106, 0x0613]),
    BinaryOutput(0x49, [0x0003, 0x26B8, 0x0018]),
)


def frame(name, **values):
    layout = message_layout(name)
    return Frame(build_frame(layout, values), layout)


def readings_of(*frames):
    readings = Readings()
    for one in frames:
        readings.update(one)
    return readings


def sensor(**values):
    return frame("HIL_SENSOR", abs_pressure=950, fields_updated=0x1FFF, **values)


def test_an_imu_sample_is_one_packet_and_one_line():
    readings = readings_of(sensor(zacc=-9.75))
    fed = SensorFeed(HOME).step(readings, HOME._replace(t_us=2_500), OUTPUTS)
    assert len(fed.vectornav) == IMU_BYTES
    line = json.loads(fed.physics)
    assert line["timestamp"] == 0.0025
    assert line["imu"]["accel_body"] == [0, 0, -9.75]
    assert line["position"] == [0, 0, 0]


def test_a_sample_dropped_by_a_fault_gives_no_packet_but_time_advances():
    readings = readings_of(sensor(zacc=-9.75))
    feed = SensorFeed(HOME)
    feed.step(readings, HOME, OUTPUTS)
    readings.begin_step()
    fed = feed.step(readings, HOME._replace(t_us=5_000), OUTPUTS)
    assert fed.vectornav == b""
    assert json.loads(fed.physics)["timestamp"] == 0.005


def test_the_second_imu_is_sent_by_json_physics():
    readings = readings_of(sensor(xgyro=0.5), sensor(id=1, xgyro=0.25))
    fed = SensorFeed(HOME).step(readings, HOME, OUTPUTS)
    assert struct.unpack_from("<f", fed.vectornav, 4 + 8) == (0.5,)
    assert json.loads(fed.physics)["imu"]["gyro"] == [0.25, 0, 0]


def test_a_fix_becomes_a_packet_and_sets_the_health():
    fix = frame("HIL_GPS", lat=474_000_000, lon=85_000_000, alt=488_000, eph=50, epv=80, vn=150,
                fix_type=3, satellites_visible=12)  # fmt: skip
    feed, readings = SensorFeed(HOME), readings_of(sensor(), fix)
    fed = feed.step(readings, HOME._replace(t_us=1_000_000), OUTPUTS)
    assert len(fed.vectornav) == IMU_BYTES + GNSS_BYTES + INS_BYTES
    values = struct.unpack("<QQBB3d3f3ff7fBB", fed.vectornav[IMU_BYTES + 8 :][:100])
    assert values[2:4] == (12, 3)
    assert values[4:7] == pytest.approx((47.4, 8.5, 488.0))
    assert values[7] == pytest.approx(1.5)
    assert values[10:13] == pytest.approx((0.5, 0.5, 0.8))


def test_nothing_is_sent_that_is_not_configured():
    assert SensorFeed(HOME).step(readings_of(sensor()), HOME).vectornav == b""


def test_an_imu_output_with_the_estimate_in_it_comes_before_any_fix():
    # ArduPilot 4.5 requests both in one output
    both = BinaryOutput(0x34, [0x072E, 0x0106, 0x0612])
    (raw,) = [SensorFeed(HOME).step(readings_of(sensor()), HOME, [both]).vectornav]
    assert len(raw) == 170
    assert struct.unpack_from("<3d", raw, 8 + 124 - 4) == (0, 0, 0)


def test_a_second_receiver_does_not_become_the_vectornav():
    readings = readings_of(sensor(), frame("HIL_GPS", id=1, fix_type=3))
    assert len(SensorFeed(HOME).step(readings, HOME, OUTPUTS).vectornav) == IMU_BYTES


def test_the_position_is_sent_in_metres_from_home():
    # a degree of latitude is 111,319 m, of longitude at 47.4 degrees 0.67688 of it
    away = HOME._replace(lat_e7=474_001_000, lon_e7=85_001_000, alt_mm=498_000)
    fed = SensorFeed(HOME).step(readings_of(sensor()), away)
    north_m, east_m, down_m = json.loads(fed.physics)["position"]
    assert north_m == pytest.approx(11.132, abs=0.001)
    assert east_m == pytest.approx(7.535, abs=0.001)
    assert down_m == -10
