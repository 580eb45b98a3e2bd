import json
import struct

import pytest

from mavproxy_fault.ardupilot.feeding.json_physics import read_servos, state_line
from mavproxy_fault.ardupilot.hil_readings import HilImu, TrueState

TRUTH = TrueState(1_002_500, (1.0, 0.0, 0.0, 0.0), 0, 0, 0, (0.0, 0.0, 0.0))
IMU = HilImu((0.0, 0.0, -9.8), (0.0, -0.25, 1e-9), (0.0, 0.0, 0.0), 95_000.0, 0.0, 15.0)
PLACE = (1.5, 0.0, -10.0)


def test_a_line_is_what_sitl_parses_byte_for_byte():
    assert state_line(TRUTH, IMU, PLACE) == (
        b'\n{"timestamp":1.002500,"imu":{"gyro":[0,-0.25,1e-09],"accel_body":[0,0,-9.8]},'
        b'"position":[1.5,0,-10],"quaternion":[1,0,0,0],"velocity":[0,0,0]}\n'
    )


def test_airspeed_is_sent_only_if_it_is_measured():
    assert json.loads(state_line(TRUTH, IMU, PLACE, 18.25))["airspeed"] == 18.25
    assert b"airspeed" not in state_line(TRUTH, IMU, PLACE)


def test_there_is_no_blank_between_a_key_and_its_vector():
    assert b" " not in state_line(TRUTH, IMU, PLACE)


def test_a_timestamp_of_a_day_keeps_its_microseconds():
    line = json.loads(state_line(TRUTH._replace(t_us=86_400_000_001), IMU, PLACE))
    assert round(line["timestamp"] * 1e6) == 86_400_000_001


def test_the_packets_of_a_real_autopilot_are_read(servo_packets):
    packets = [read_servos(data) for data in servo_packets]
    assert all(packet is not None for packet in packets)
    assert packets[0].accepted == 0
    assert min(packets[-1].pwm_us[:4]) > 1600  # lift-off
    assert all(len(packet.pwm_us) == 16 for packet in packets)


def test_thirty_two_outputs_are_read_too():
    data = struct.pack("<HHI32H", 29569, 400, 7, *range(32))
    packet = read_servos(data)
    assert packet is not None
    assert packet.pwm_us == tuple(range(32))


@pytest.mark.parametrize(
    "data", [b"", b"\x1a\x48", struct.pack("<HHI16H", 1, 0, 0, *[0] * 16), b"\x1a\x48" + bytes(39)]
)
def test_bytes_that_are_not_a_servo_packet_give_none(data):
    assert read_servos(data) is None
