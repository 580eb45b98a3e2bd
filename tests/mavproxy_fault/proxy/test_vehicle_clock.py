from mavproxy_fault.proxy.senders import new_senders
from mavproxy_fault.proxy.vehicle_clock import VehicleClock, stamp_us
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

UNIX_US = 1_700_000_000_000_000


def frame(name: str, system: int = 1, component: int = 1, **values: object) -> Frame:
    return Frame(
        build_frame(message_layout(name), values, system=system, component=component),
        message_layout(name),
    )


def test_timestamps_are_read_in_microseconds_even_with_truncated_zeros() -> None:
    assert stamp_us(frame("HIL_SENSOR", time_usec=1_234_567)) == 1_234_567
    assert stamp_us(frame("ATTITUDE", time_boot_ms=70_000)) == 70_000_000
    assert stamp_us(frame("ATTITUDE", time_boot_ms=5)) == 5_000
    assert stamp_us(frame("SYSTEM_TIME", time_unix_usec=UNIX_US, time_boot_ms=9)) == 9_000
    assert stamp_us(frame("HEARTBEAT", type=2)) == 0


def test_the_first_stamp_starts_the_timeline_and_frames_without_one_take_the_newest() -> None:
    clock = VehicleClock(new_senders())
    assert clock.read(frame("HEARTBEAT", type=2), 123) == 123
    assert clock.t0_us is None
    assert clock.read(frame("ATTITUDE", time_boot_ms=60_000), 124) == 60_000_000
    assert clock.t0_us == 60_000_000
    assert clock.read(frame("HEARTBEAT", type=2), 999_999) == 60_000_000
    assert clock.read(frame("HEARTBEAT", 255, type=2), 999_999) == 60_000_000


def test_a_system_that_stamped_long_ago_takes_the_newest_time_of_any() -> None:
    """MAVSDK stamps one PING, then sends heartbeats only."""
    clock = VehicleClock(new_senders())
    clock.read(frame("HIL_SENSOR", component=51, time_usec=2_000_000), 0)
    clock.read(frame("PING", 245, time_usec=2_000_000), 0)
    clock.read(frame("HIL_SENSOR", component=51, time_usec=11_000_000), 1)
    assert clock.read(frame("HEARTBEAT", 245, type=6), 2) == 2_000_000
    clock.read(frame("HIL_SENSOR", component=51, time_usec=20_000_000), 3)
    assert clock.read(frame("HEARTBEAT", 245, type=6), 4) == 20_000_000


def test_a_clock_near_the_timeline_is_used_unchanged() -> None:
    clock = VehicleClock(new_senders())
    clock.read(frame("HIL_SENSOR", component=51, time_usec=2_000_000), 0)
    assert clock.read(frame("ATTITUDE", time_boot_ms=1_990), 0) == 1_990_000


def test_unix_stamps_of_the_same_system_are_shifted_onto_the_timeline() -> None:
    clock = VehicleClock(new_senders())
    clock.read(frame("ATTITUDE", time_boot_ms=60_000), 0)
    assert clock.read(frame("GPS_RAW_INT", time_usec=UNIX_US), 0) == 60_000_000
    clock.read(frame("ATTITUDE", time_boot_ms=61_000), 0)
    assert clock.read(frame("GPS_RAW_INT", time_usec=UNIX_US + 1_500_000), 0) == 61_500_000


def test_each_vehicle_has_its_own_clock() -> None:
    clock = VehicleClock(new_senders())
    clock.read(frame("ATTITUDE", 1, time_boot_ms=60_000), 0)
    assert clock.read(frame("ATTITUDE", 2, time_boot_ms=900_000), 0) == 60_000_000
    clock.read(frame("ATTITUDE", 1, time_boot_ms=62_000), 0)
    assert clock.read(frame("ATTITUDE", 2, time_boot_ms=901_000), 0) == 61_000_000
    assert clock.read(frame("HEARTBEAT", 2, type=2), 0) == 61_000_000


def test_time_continues_after_a_reboot() -> None:
    clock = VehicleClock(new_senders())
    clock.read(frame("ATTITUDE", time_boot_ms=60_000), 0)
    assert clock.read(frame("ATTITUDE", time_boot_ms=1_000), 0) == 60_000_000
    assert clock.read(frame("ATTITUDE", time_boot_ms=3_000), 0) == 62_000_000


def test_one_wrong_timestamp_changes_nothing() -> None:
    for wrong_ms in (80_001, 120_000, 4_000_000_000, 1_000):
        clock = VehicleClock(new_senders())
        clock.read(frame("ATTITUDE", time_boot_ms=60_000), 0)
        assert clock.read(frame("ATTITUDE", time_boot_ms=wrong_ms), 10_000) == 60_000_000
        assert clock.read(frame("ATTITUDE", time_boot_ms=60_020), 20_000) == 60_020_000
        assert clock.read(frame("ATTITUDE", time_boot_ms=wrong_ms), 30_000) == 60_020_000


def test_a_time_jump_confirmed_by_a_second_timestamp_or_the_wall_clock_is_followed() -> None:
    clock = VehicleClock(new_senders())
    clock.read(frame("ATTITUDE", time_boot_ms=60_000), 0)
    assert clock.read(frame("ATTITUDE", time_boot_ms=90_000), 10_000) == 60_000_000
    assert clock.read(frame("ATTITUDE", time_boot_ms=90_010), 20_000) == 90_010_000
    after_a_break_us = 25_000_000
    assert clock.read(frame("ATTITUDE", time_boot_ms=120_000), after_a_break_us) == 120_000_000


def test_an_impossible_timestamp_is_read_as_none() -> None:
    for stamp in (1 << 53, (1 << 63) - 1, 1 << 63, (1 << 64) - 1):
        clock = VehicleClock(new_senders())
        assert clock.read(frame("HIL_SENSOR", time_usec=stamp), 55) == 55
        clock.read(frame("HIL_SENSOR", time_usec=1_000), 60)
        assert clock.read(frame("HIL_SENSOR", time_usec=stamp), 65) == 1_000


def test_microseconds_in_32_bits_are_not_a_clock() -> None:
    """SERVO_OUTPUT_RAW wraps every 72 minutes, while its sender's other timestamps continue."""
    hours = 3 * 3600 * 1000
    outputs = frame("SERVO_OUTPUT_RAW", time_usec=(hours * 1000) % 2**32)
    assert stamp_us(outputs) == 0
    clock = VehicleClock(new_senders())
    clock.read(frame("ATTITUDE", time_boot_ms=hours), 0)
    for n in range(1, 5):
        assert clock.read(outputs, n) == (hours + n - 1) * 1000
        assert clock.read(frame("ATTITUDE", time_boot_ms=hours + n), n) == (hours + n) * 1000


def test_the_simulator_s_clock_becomes_the_timeline_whoever_stamped_before() -> None:
    clock = VehicleClock(new_senders())
    uptime_ms = 11_000_000
    clock.read(frame("ATTITUDE", time_boot_ms=uptime_ms), 0)
    assert clock.read(frame("HIL_SENSOR", component=51, time_usec=4_000), 0) == 4_000
    assert clock.t0_us == 4_000
    clock.read(frame("ATTITUDE", time_boot_ms=uptime_ms + 20), 20_000)
    clock.read(frame("HIL_SENSOR", component=51, time_usec=1_500_000), 1_500_000)
    # PX4 takes the simulator's time over: two stamps later it counts unshifted.
    clock.read(frame("ATTITUDE", time_boot_ms=1_480), 1_500_000)
    assert clock.read(frame("ATTITUDE", time_boot_ms=1_490), 1_510_000) == 1_490_000
    assert clock.read(frame("HIL_SENSOR", 2, component=51, time_usec=900_000_000), 1) == 1_490_000


def test_a_simulator_on_unix_time_leaves_the_timeline_as_it_is() -> None:
    clock = VehicleClock(new_senders())
    clock.read(frame("ATTITUDE", time_boot_ms=60_000), 0)
    assert clock.read(frame("HIL_SENSOR", component=51, time_usec=UNIX_US), 0) == 60_000_000
