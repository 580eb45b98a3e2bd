import math

import pytest

from mavproxy_fault.ardupilot.parameters import (
    VEHICLE_KINDS,
    bridge_parameters,
    check_parameters,
)
from mavproxy_fault.documents.errors import ConfigError
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing

BARE = (400.0, set(), None)


@pytest.mark.parametrize("kind", VEHICLE_KINDS)
def test_all_of_sitls_own_sensors_are_removed(kind):
    values = bridge_parameters(kind, *BARE)
    assert values["AHRS_EKF_TYPE"] == 3
    assert values["SIM_IMU_COUNT"] == values["SIM_BARO_COUNT"] == values["SIM_GPS1_ENABLE"] == 0
    assert all(values[f"SIM_MAG{number}_DEVID"] == 0 for number in range(1, 7))


def test_redundant_sensors_are_all_used():
    values = bridge_parameters(
        "copter", 400.0, {("HIL_SENSOR", 1), ("HIL_GPS", 1), ("DISTANCE_SENSOR", 0)}, None
    )
    assert (values["SIM_IMU_COUNT"], values["EK3_IMU_MASK"]) == (1, 3)
    assert values["GPS2_TYPE"] == 14
    assert values["RNGFND1_TYPE"] == 10
    assert "GPS2_TYPE" not in bridge_parameters("copter", *BARE)


def test_flow_and_vision_are_read_by_mavlink_if_available():
    values = bridge_parameters("copter", 400.0, {("HIL_OPTICAL_FLOW", 0), ("ODOMETRY", 0)}, None)
    assert (values["FLOW_TYPE"], values["FLOW_FXSCALER"], values["VISO_TYPE"]) == (5, -990, 1)
    assert not {"FLOW_TYPE", "VISO_TYPE"} & bridge_parameters("copter", *BARE).keys()


def test_remote_control_and_battery_have_failsafes_only_if_there_are_any():
    values = bridge_parameters("copter", 400.0, {("RC_CHANNELS", 0)}, 16.8)
    assert values["FS_THR_ENABLE"] == 1
    # SITL takes up to 0.7 V off at full throttle: half of it in hover
    assert 12.0 < values["BATT_CRT_VOLT"] < values["BATT_LOW_VOLT"] < 0.81 * 16.8
    bare = bridge_parameters("copter", *BARE)
    assert bare["FS_THR_ENABLE"] == bare["BATT_MONITOR"] == 0


def test_the_loop_is_no_faster_than_the_steps():
    assert bridge_parameters("copter", 250.0, set(), None)["SCHED_LOOP_RATE"] == 250
    assert bridge_parameters("plane", *BARE)["SCHED_LOOP_RATE"] == 100


def test_an_estimator_that_reads_the_truth_is_refused():
    with pytest.raises(ConfigError, match=r"AHRS_EKF_TYPE = 10 bypasses .* set it to 3"):
        check_parameters({"ATC_RAT_RLL_P": 0.2, "AHRS_EKF_TYPE": 10.0})


def test_other_parameters_may_be_set_by_the_user():
    check_parameters({"AHRS_EKF_TYPE": 3.0, "ATC_RAT_RLL_P": 0.2})


def test_a_planes_feed_forward_deflects_as_far_as_the_simulated_aerosonde_needs():
    values = bridge_parameters("plane", *BARE)
    plane = FixedWing.read("aerosonde-2025")
    aero, speed_mps, density = plane.aero, values["SCALING_SPEED"], 1.17
    # Steady rates per deflection, by the moments' balance; in a pull-up, lift turns the path.
    roll = -2.0 * speed_mps / aero.b * aero.crda / aero.crp
    lift_mps2 = 0.5 * density * speed_mps**2 * aero.s * aero.cla / plane.parameters.mass_kg
    pitch = aero.cmde / (aero.cma * speed_mps / lift_mps2 + aero.cmq * aero.c / (2.0 * speed_mps))
    elevator_rad, aileron_rad, _ = plane.throw_rad
    full_output_rad = math.radians(45.0)
    assert values["RLL_RATE_FF"] == pytest.approx(full_output_rad / (roll * aileron_rad), rel=0.05)
    assert values["PTCH_RATE_FF"] == pytest.approx(
        full_output_rad / (pitch * elevator_rad), rel=0.05
    )
