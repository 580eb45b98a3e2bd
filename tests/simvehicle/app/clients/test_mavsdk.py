"""The real MAVSDK client commands the simulated vehicle over UDP."""

import math
from collections.abc import Iterator
from typing import Any

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk, System, log_subscribe
from mavsdk.plugins.action import Action
from mavsdk.plugins.failure import Failure, FailureError, FailureType, FailureUnit
from mavsdk.plugins.mission import Mission, MissionItem, MissionPlan
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import FlightMode, LandedState, Telemetry

M_PER_DEG = 111_320.0
WITH_MISSION = """
vehicle: {kind: multirotor, parameters: iris}
sensors: {imu: {rate_hz: 100}, gps: {preset: ideal, rate_hz: 5}}
mission: [{shape: line, size_m: 60, height_m: 15, speed_mps: 5}]
"""


@pytest.fixture
def system(flown: Any) -> Iterator[System]:
    """The vehicle as MAVSDK sees it."""
    log_subscribe(lambda *_: True)
    station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    with Mavsdk(station) as mavsdk:
        mavsdk.add_any_connection(f"udpin://127.0.0.1:{flown.port}")
        found = mavsdk.first_autopilot(30.0)
        assert found is not None
        yield found


def take_off(system: System, until: Any, height_m: float = 8.0) -> Telemetry:
    telemetry, action = Telemetry(system), Action(system)
    until(telemetry.subscribe_health_all_ok, bool)
    action.set_takeoff_altitude(height_m)
    action.arm()
    action.takeoff()
    until(
        telemetry.subscribe_position,
        lambda p: abs(p.relative_altitude_m - height_m) < 0.5,
    )
    return telemetry


def item(home: Any, north_m: float, east_m: float, height_m: float) -> MissionItem:
    across = M_PER_DEG * math.cos(math.radians(home.latitude_deg))
    return MissionItem(
        latitude_deg=home.latitude_deg + north_m / M_PER_DEG,
        longitude_deg=home.longitude_deg + east_m / across,
        relative_altitude_m=height_m,
        speed_m_s=6.0,
        is_fly_through=True,
        gimbal_pitch_deg=math.nan,
        gimbal_yaw_deg=math.nan,
        camera_action=MissionItem.CameraAction.NONE,
        loiter_time_s=math.nan,
        camera_photo_interval_s=math.nan,
        acceptance_radius_m=2.0,
        yaw_deg=math.nan,
        camera_photo_distance_m=math.nan,
        vehicle_action=MissionItem.VehicleAction.NONE,
    )


def test_it_sees_a_healthy_px4_multirotor(system: System, until: Any) -> None:
    assert (system.autopilot_type().name, system.vehicle_type().name) == ("PX4", "MULTICOPTER")
    until(Telemetry(system).subscribe_health_all_ok, bool)


def test_it_arms_takes_off_and_lands(system: System, until: Any, flown: Any) -> None:
    telemetry = take_off(system, until)
    assert telemetry.flight_mode() in (FlightMode.HOLD, FlightMode.TAKEOFF)
    Action(system).land()
    until(telemetry.subscribe_armed, lambda armed: not armed)
    until(telemetry.subscribe_landed_state, lambda state: state == LandedState.ON_GROUND)
    assert flown.simulation.truth.on_ground


def test_it_uploads_flies_and_downloads_a_mission(system: System, until: Any, flown: Any) -> None:
    telemetry = take_off(system, until)
    home = telemetry.home()
    mission = Mission(system)
    mission.upload_mission(MissionPlan([item(home, 15, 0, 10), item(home, 15, 12, 10)]))
    plan = mission.download_mission()
    assert [round(i.relative_altitude_m) for i in plan.mission_items] == [10, 10]
    mission.start_mission()
    until(mission.subscribe_mission_progress, lambda p: p.current == p.total == 2)
    assert mission.is_mission_finished()
    north, east, _ = flown.simulation.truth.r_ned_m.tolist()
    assert math.hypot(north - 15, east - 12) < 4.0


@pytest.mark.parametrize("flown", [WITH_MISSION], indirect=True)
def test_the_scenarios_mission_can_be_downloaded_and_started_after_arming(
    system: System, until: Any, flown: Any
) -> None:
    telemetry, action, mission = Telemetry(system), Action(system), Mission(system)
    until(telemetry.subscribe_health_all_ok, bool)
    items = mission.download_mission().mission_items
    assert [round(i.relative_altitude_m) for i in items] == [15] * len(items)
    assert {i.speed_m_s for i in items[:1]} == {5.0}
    action.arm()
    mission.start_mission()
    until(telemetry.subscribe_position, lambda p: p.relative_altitude_m > 14.0)
    action.kill()
    until(telemetry.subscribe_armed, lambda armed: not armed)
    until(telemetry.subscribe_landed_state, lambda state: state == LandedState.ON_GROUND)
    action.arm()
    until(telemetry.subscribe_armed, bool)


def test_it_sends_the_vehicle_to_a_position(system: System, until: Any, flown: Any) -> None:
    telemetry = take_off(system, until)
    home = telemetry.home()
    Action(system).goto_location(
        home.latitude_deg + 20 / M_PER_DEG, home.longitude_deg, home.absolute_altitude_m + 12, 0.0
    )
    until(
        telemetry.subscribe_position,
        lambda p: abs(p.latitude_deg - home.latitude_deg - 20 / M_PER_DEG) < 2 / M_PER_DEG,
    )
    assert abs(flown.simulation.truth.r_ned_m[1]) < 3.0


def test_it_reads_and_sets_parameters(system: System) -> None:
    param = Param(system)
    assert param.get_param_int("SYS_FAILURE_EN") == 0
    param.set_param_int("SYS_FAILURE_EN", 1)
    assert param.get_param_int("SYS_FAILURE_EN") == 1
    param.set_param_float("MIS_TAKEOFF_ALT", 7.5)
    assert param.get_param_float("MIS_TAKEOFF_ALT") == 7.5
    everything = param.get_all_params()
    assert len(everything.int_params) + len(everything.float_params) >= 12


def test_a_failure_is_denied_until_a_parameter_enables_it(system: System) -> None:
    with pytest.raises(FailureError, match=r"DENIED|DISABLED"):
        Failure(system).inject(FailureUnit.SYSTEM_MOTOR, FailureType.OFF, 1)


def test_an_injected_motor_failure_stops_the_motor(system: System, until: Any, flown: Any) -> None:
    Param(system).set_param_int("SYS_FAILURE_EN", 1)
    telemetry = take_off(system, until)
    Failure(system).inject(FailureUnit.SYSTEM_MOTOR, FailureType.OFF, 1)
    until(telemetry.subscribe_attitude_euler, lambda a: max(abs(a.roll_deg), abs(a.pitch_deg)) > 25)
