import math

import pytest

from mavproxy_fault.ardupilot.hil_readings import HilImu, Readings, TrueState, true_airspeed
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame


def frame(name, **values):
    layout = message_layout(name)
    return Frame(build_frame(layout, values), layout)


def test_a_sensor_frame_is_read_in_si_units():
    readings = Readings()
    ended = readings.update(
        frame("HIL_SENSOR", xacc=1, zgyro=0.5, ymag=0.25, abs_pressure=1000, diff_pressure=2,
              temperature=15, fields_updated=0x1FFF)
    )  # fmt: skip
    imu = readings.imus[0]
    assert not ended
    assert readings.fresh_imu
    assert imu == HilImu((1, 0, 0), (0, 0, 0.5), (0, 0.25, 0), 100_000, 200, 15)


def test_the_truth_ends_a_step():
    readings = Readings()
    assert readings.update(
        frame("HIL_STATE_QUATERNION", time_usec=5000, attitude_quaternion=(1, 0, 0, 0), lat=1,
              lon=2, alt=3, vx=100, vy=-200, vz=50)
    )  # fmt: skip
    assert readings.truth == TrueState(5000, (1, 0, 0, 0), 1, 2, 3, (1.0, -2.0, 0.5))


def test_a_new_step_shows_missing_samples():
    readings = Readings()
    readings.update(frame("HIL_SENSOR", fields_updated=0x1FFF))
    readings.update(frame("HIL_GPS", fix_type=3))
    assert readings.fresh_imu
    readings.begin_step()
    assert not readings.fresh_imu
    assert not readings.fixes


def test_the_second_imu_alone_is_no_sample_of_the_first():
    readings = Readings()
    readings.update(frame("HIL_SENSOR", fields_updated=0x1FFF, id=1))
    assert not readings.fresh_imu


def test_an_imu_without_power_gives_no_sample():
    readings = Readings()
    readings.update(frame("HIL_SENSOR", fields_updated=0x1FC0))
    assert not readings.fresh_imu


def test_a_battery_is_the_sum_of_its_cells():
    readings = Readings()
    cells = (4_000, 4_100, 3_900, *(0xFFFF,) * 7)
    readings.update(frame("BATTERY_STATUS", voltages=cells, current_battery=250))
    assert readings.battery_v == pytest.approx(12.0)


@pytest.mark.parametrize("unknown", [{"id": 1}, {"voltages": (0xFFFF,) * 10}])
def test_a_second_battery_or_one_without_values_changes_nothing(unknown):
    readings = Readings()
    values = {"voltages": (12_000, *(0xFFFF,) * 9), "current_battery": 250, **unknown}
    readings.update(frame("BATTERY_STATUS", **values))
    assert readings.battery_v is None


@pytest.mark.parametrize("yaw_deg", [0, 45, 190, 359])
def test_the_heading_of_a_quaternion(yaw_deg):
    half = math.radians(yaw_deg) / 2
    state = TrueState(0, (math.cos(half), 0, 0, math.sin(half)), 0, 0, 0, (0, 0, 0))
    assert state.yaw_deg == pytest.approx(yaw_deg, abs=1e-9)


def test_airspeed_from_dynamic_pressure_at_sea_level():
    # ICAO standard atmosphere at sea level: 1.225 kg/m3; half of it times the speed squared
    imu = HilImu((0, 0, 0), (0, 0, 0), (0, 0, 0), 101_325, 0.5 * 1.225 * 20**2, 15.0)
    assert true_airspeed(imu) == pytest.approx(20.0, rel=1e-4)
    assert true_airspeed(imu._replace(diff_pressure_pa=-5.0)) == 0.0
    assert true_airspeed(imu._replace(pressure_pa=0.0)) == 0.0
