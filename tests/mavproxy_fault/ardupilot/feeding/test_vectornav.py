import struct

import pytest
from fastcrc.crc16 import xmodem

from mavproxy_fault.ardupilot.feeding.vectornav import (
    GPS_EPOCH_US,
    NO_FIX,
    BinaryOutput,
    gnss_values,
    imu_values,
)
from mavproxy_fault.ardupilot.hil_readings import HilImu
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

IMU = HilImu((0.0, 1.0, -9.75), (0.5, -0.25, 0.125), (0.25, 0.0, 0.5), 101_000.0, 0.0, 20.0)
HIL_GPS = message_layout("HIL_GPS")


def fix_of(**changed):
    values = {
        "satellites_visible": 14, "fix_type": 3, "lat": 475_000_000, "lon": 85_000_000,
        "alt": 488_000, "vn": 100, "ve": -200, "vd": 50, "eph": 50, "epv": 100,
    }  # fmt: skip
    return Frame(build_frame(HIL_GPS, values | changed), HIL_GPS)


VALUES = {**imu_values(IMU, 2_500), **gnss_values(fix_of())}
GPS_TIME_NS = (GPS_EPOCH_US + 2_500) * 1000
IMU_OUTPUT = BinaryOutput(0x01, [0x0721])
ESTIMATE_OUTPUT = BinaryOutput(0x31, [0x0001, 0x0106, 0x0613])
GNSS_OUTPUT = BinaryOutput(0x49, [0x0003, 0x26B8, 0x0018])
IMU_OUTPUT_4_5 = BinaryOutput(0x34, [0x072E, 0x0106, 0x0612])
GNSS_OUTPUT_4_5 = BinaryOutput(0x4E, [0x0002, 0x0010, 0x20B8, 0x0018])
OUTPUTS = (IMU_OUTPUT, ESTIMATE_OUTPUT, GNSS_OUTPUT, IMU_OUTPUT_4_5, GNSS_OUTPUT_4_5)


def test_an_imu_packet_byte_for_byte():
    packet = IMU_OUTPUT.packet(VALUES)
    assert (
        packet.hex()
        == (
            "fa012107"
            "a025260000000000"  # 2,500,000 ns
            "0000003f000080be0000003e"  # gyro
            "000000000000803f00001cc1"  # accel
            "000000000000803f00001cc1"  # uncompensated accel
            "0000003f000080be0000003e"  # uncompensated gyro
            "0000803e000000000000003f"  # mag
            "0000a041"  # temperature
            "0000ca42"  # 101 kPa
        )
        + xmodem(packet[1:-2]).to_bytes(2, "big").hex()
    )


@pytest.mark.parametrize("output", OUTPUTS)
def test_the_crc_over_a_packet_and_its_crc_is_zero(output):
    assert xmodem(output.packet(VALUES)[1:]) == 0


def test_the_crc_is_that_of_vectornav():
    # CRC-16 with polynomial 0x1021 and start 0, bit by bit as in VectorNav's user manual
    crc = 0
    for byte in IMU_OUTPUT.packet(VALUES)[1:-2]:
        crc = (crc >> 8 | crc << 8) & 0xFFFF
        crc ^= byte
        crc ^= (crc & 0xFF) >> 4
        crc ^= crc << 12 & 0xFFFF
        crc ^= (crc & 0xFF) << 5 & 0xFFFF
    assert IMU_OUTPUT.packet(VALUES)[-2:] == crc.to_bytes(2, "big")


def test_packets_have_the_lengths_that_the_drivers_wait_for():
    lengths = [len(output.packet(VALUES)) for output in OUTPUTS]
    # sync, header, payload, CRC; the lengths of 4.5 are from its driver
    assert lengths == [1 + 3 + 76 + 2, 1 + 7 + 94 + 2, 1 + 7 + 100 + 2, 170, 92]


def test_outputs_are_triggered_by_their_contents():
    paces = [output.pace for output in OUTPUTS]
    assert paces == ["imu", "estimate", "gnss", "imu", "gnss"]


def test_a_fix_can_be_read_back():
    packet = GNSS_OUTPUT.packet(VALUES)
    assert packet[:8].hex() == "fa490300b8261800"
    values = struct.unpack("<QQBB3d3f3ff7fBB", packet[8:-2])
    assert values[:4] == (2_500_000, GPS_TIME_NS, 14, 3)
    assert values[4:7] == pytest.approx((47.5, 8.5, 488.0), rel=1e-12)
    assert values[7:10] == (1.0, -2.0, 0.5)
    assert values[-2:] == (14, 3)


def test_the_packets_of_4_5_can_be_read_back():
    packet = IMU_OUTPUT_4_5.packet(VALUES)
    assert packet[:8].hex() == "fa342e0706011206"
    values = struct.unpack("<3f3f3ff3f3f3f3f4f3f3d3fff", packet[8:-2])
    assert values[3:9] == (0.0, 1.0, -9.75, 0.5, -0.25, 0.125)
    assert values[9] == 101.0
    assert values[29:32] == pytest.approx((47.5, 8.5, 488.0), rel=1e-12)
    packet = GNSS_OUTPUT_4_5.packet(VALUES)
    assert packet[:10].hex() == "fa4e02001000b8201800"
    values = struct.unpack("<QfBB3d3f7fBB", packet[10:-2])
    assert values[:4] == (GPS_TIME_NS, 20.0, 14, 3)


def test_a_better_fix_than_3d_is_3d():
    assert gnss_values(fix_of(fix_type=6))["fix"] == (3,)


def test_the_sensor_does_not_reveal_the_true_attitude():
    values = struct.unpack("<Q3f4f3fH3d3fff", ESTIMATE_OUTPUT.packet(VALUES)[8:-2])
    assert values[1:8] == (0, 0, 0, 0, 0, 0, 1)
    assert values[11] == 6  # tracking, with a fix


def test_before_any_fix_the_sensor_tracks_nothing():
    values = struct.unpack(
        "<Q3f4f3fH3d3fff", ESTIMATE_OUTPUT.packet({**VALUES, **gnss_values(NO_FIX)})[8:-2]
    )
    assert values[11] == 0


@pytest.mark.parametrize(
    ("groups", "words", "message"),
    [
        (0x01, [0x0008], "field 3 of group 1 is not supported"),
        (0x80, [0x0001], "group 8"),
        (0x05, [0x0001], "needs one for each group"),
    ],
)
def test_an_unsupported_output_is_refused(groups, words, message):
    with pytest.raises(ConfigError, match=message):
        BinaryOutput(groups, words)
