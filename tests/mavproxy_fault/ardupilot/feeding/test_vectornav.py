import struct

from fastcrc.crc16 import xmodem

from mavproxy_fault.ardupilot.feeding.vectornav import (
    GnssOutput,
    ImuOutput,
    gnss_packet,
    imu_packet,
    ins_packet,
)

IMU = ImuOutput(2_500, (0.5, -0.25, 0.125), (0.0, 1.0, -9.75), (0.25, 0.0, 0.5), 20.0, 101_000.0)
FIX = GnssOutput(
    t_us=5_000,
    gps_time_us=7_000,
    satellites=14,
    fix=3,
    lat_deg=47.5,
    lon_deg=8.5,
    alt_m=488.0,
    v_ned_mps=(1.0, -2.0, 0.5),
    sigma_ned_m=(0.5, 0.5, 1.0),
    sigma_v_mps=0.25,
    dop=0.5,
)


def test_an_imu_packet_byte_for_byte():
    assert (
        imu_packet(IMU).hex()
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
        + xmodem(imu_packet(IMU)[1:-2]).to_bytes(2, "big").hex()
    )


def test_the_crc_over_a_packet_and_its_crc_is_zero():
    for packet in (imu_packet(IMU), gnss_packet(FIX), ins_packet(FIX, 9_000)):
        assert xmodem(packet[1:]) == 0


def test_the_crc_is_that_of_vectornav():
    # CRC-16 with polynomial 0x1021 and start 0, bit by bit as in VectorNav's user manual
    crc = 0
    for byte in imu_packet(IMU)[1:-2]:
        crc = (crc >> 8 | crc << 8) & 0xFFFF
        crc ^= byte
        crc ^= (crc & 0xFF) >> 4
        crc ^= crc << 12 & 0xFFFF
        crc ^= (crc & 0xFF) << 5 & 0xFFFF
    assert imu_packet(IMU)[-2:] == crc.to_bytes(2, "big")


def test_packets_have_the_lengths_that_the_driver_waits_for():
    lengths = [len(imu_packet(IMU)), len(gnss_packet(FIX)), len(ins_packet(FIX, 0))]
    assert lengths == [1 + 3 + 76 + 2, 1 + 7 + 100 + 2, 1 + 7 + 94 + 2]


def test_a_fix_can_be_read_back():
    packet = gnss_packet(FIX)
    assert packet[:8].hex() == "fa490300b8261800"
    values = struct.unpack("<QQBB3d3f3ff7fBB", packet[8:-2])
    assert values[:4] == (5_000_000, 7_000_000, 14, 3)
    assert values[4:7] == (47.5, 8.5, 488.0)
    assert values[7:10] == (1.0, -2.0, 0.5)
    assert values[-2:] == (14, 3)


def test_a_better_fix_than_3d_is_3d():
    packet = gnss_packet(FIX._replace(fix=6))
    assert struct.unpack("<QQBB", packet[8:26])[3] == 3


def test_the_sensor_tells_no_attitude_of_its_own():
    packet = ins_packet(FIX, 9_000)
    values = struct.unpack("<Q3f4f3fH3d3fff", packet[8:-2])
    assert values[1:8] == (0, 0, 0, 0, 0, 0, 1)
