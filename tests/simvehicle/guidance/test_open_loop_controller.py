"""Constant controls and weaving instead of a mission, from a configured start state."""

import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.rotations.rotation import euler_from_quat
from simvehicle.guidance.route import CircleTrack
from simvehicle.scenario.scenario_file import (
    Leg,
    OpenLoopControls,
    Scenario,
    StartConfig,
    StartState,
    VehicleChoice,
    WeaveChoice,
)
from simvehicle.simulation.simulation import Simulation

STATE = StartState(u_mps=35.0, w_mps=0.1, roll_deg=25.0, pitch_deg=3.0, q_dps=-7.0)
WEAVE = WeaveChoice(roll_deg=30.0, period_s=10.0, pitch_deg=0.0, airspeed_mps=35.0)


def simulation(controls):
    return Simulation(
        Scenario(
            start=StartConfig(height_m=500.0, heading_deg=40.0, state=STATE),
            vehicle=VehicleChoice(parameters="aerosonde-2012"),
            controls=controls,
        )
    )


def test_a_flight_starts_in_the_configured_state():
    truth = simulation(OpenLoopControls()).truth
    assert np.degrees(euler_from_quat(truth.q_nb)) == pytest.approx([25.0, 3.0, 40.0])
    assert truth.v_air_b_mps == pytest.approx([35.0, 0.0, 0.1])
    assert np.degrees(truth.omega_b_rps) == pytest.approx([0.0, -7.0, 0.0])
    assert truth.height_agl_m == pytest.approx(500.0, abs=1e-6)


def test_open_loop_controls_stay_as_they_are():
    flight = simulation(OpenLoopControls(elevator_deg=-3.0, aileron_deg=2.0, throttle=0.4))
    for _ in range(5):
        flight.step()
    throws = np.degrees(flight.vehicle.throw_rad)
    assert flight.controls == pytest.approx([-3.0 / throws[0], 2.0 / throws[1], 0.0, 0.4])


def test_weaving_rolls_from_side_to_side_at_constant_airspeed():
    flight = simulation(OpenLoopControls(elevator_deg=-2.8, throttle=0.46, weave=WEAVE))
    rolls, speeds = [], []
    for _ in range(20 * 250):
        _, truth, _ = flight.step()
        rolls.append(np.degrees(euler_from_quat(truth.q_nb)[0]))
        speeds.append(np.linalg.norm(truth.v_air_b_mps))
    assert max(rolls) == pytest.approx(30.0, abs=6.0)
    assert min(rolls) == pytest.approx(-30.0, abs=6.0)
    assert speeds[-1] == pytest.approx(35.0, abs=3.0)


def test_a_track_replaces_open_loop_controls():
    flight = simulation(OpenLoopControls(elevator_deg=-2.8, throttle=0.46))
    flight.controller.track = CircleTrack(0.0, 0.0, 500.0, 400.0, 35.0)
    for _ in range(10 * 250):
        _, truth, _ = flight.step()
    assert truth.height_agl_m == pytest.approx(500.0, abs=15.0)


def test_controls_and_a_mission_exclude_each_other():
    with pytest.raises(ValueError, match="or multirotor without mission"):
        Scenario(controls=OpenLoopControls(), mission=[Leg(shape="line")])


def test_a_start_state_needs_height():
    with pytest.raises(ValueError, match="state needs a start in the air"):
        StartConfig(state=STATE)


def quadrotor(parameters: str = "iris") -> Simulation:
    """A multirotor that sways by 15 degrees every 5 s, 40 m above the ground."""
    return Simulation(
        Scenario(
            start=StartConfig(height_m=40.0, state=StartState(u_mps=0.0)),
            vehicle=VehicleChoice(kind="multirotor", parameters=parameters),
            controls=OpenLoopControls(
                weave=WeaveChoice(roll_deg=15.0, period_s=5.0, pitch_deg=-5.0)
            ),
        )
    )


def test_a_quadrotor_sways_at_constant_height() -> None:
    flight = quadrotor()
    rolls, pitches, heights = [], [], []
    for _ in range(10 * 250):
        _, truth, _ = flight.step()
        roll, pitch, _ = np.degrees(euler_from_quat(truth.q_nb))
        rolls.append(roll)
        pitches.append(pitch)
        heights.append(truth.height_agl_m)
    assert max(rolls) == pytest.approx(15.0, abs=2.0)
    assert min(rolls) == pytest.approx(-15.0, abs=2.0)
    assert pitches[-1] == pytest.approx(-5.0, abs=2.0)
    # The battery's voltage falls a little: no integral term compensates for it.
    assert heights == pytest.approx([40.0] * len(heights), abs=1.0)


def test_a_track_ends_the_swaying() -> None:
    flight = quadrotor()
    for _ in range(250):
        flight.step()
    north_m, east_m, _ = flight.truth.r_ned_m.tolist()
    flight.controller.track = flight.controller.circle(north_m, east_m, 45.0, 2.0)
    for _ in range(15 * 250):
        flight.step()
    assert flight.truth.height_agl_m == pytest.approx(45.0, abs=0.5)


def test_swaying_is_refused_for_six_rotors() -> None:
    with pytest.raises(ConfigError, match="6 rotors cannot weave; use a vehicle with 4"):
        quadrotor("hexa")


@pytest.mark.parametrize(
    ("kind", "controls", "error"),
    [
        ("multirotor", OpenLoopControls(), "controls of a multirotor must be weave alone"),
        (
            "multirotor",
            OpenLoopControls(throttle=0.5, weave=WEAVE),
            "controls of a multirotor must be weave",
        ),
        ("multirotor", OpenLoopControls(weave=WEAVE), "airspeed_mps is for a fixed wing"),
        (
            "fixedwing",
            OpenLoopControls(weave=WeaveChoice(roll_deg=5.0, period_s=5.0, pitch_deg=0.0)),
            "airspeed_mps is for a fixed wing only",
        ),
    ],
)
def test_controls_of_another_kind_of_vehicle_are_refused(
    kind: str, controls: OpenLoopControls, error: str
) -> None:
    with pytest.raises(ValueError, match=error):
        Scenario(vehicle=VehicleChoice(kind=kind), controls=controls)
