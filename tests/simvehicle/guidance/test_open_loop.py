"""Constant controls and weaving in the place of a mission, from a start state of one's own."""

import numpy as np
import pytest

from mavproxy_fault.numerics.rotations.rotation import euler_from_quat
from simvehicle.guidance.route import CircleTrack
from simvehicle.scenario.scenario_file import (
    Leg,
    OpenLoop,
    Scenario,
    Start,
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
            start=Start(height_m=500.0, heading_deg=40.0, state=STATE),
            vehicle=VehicleChoice(parameters="aerosonde-2012"),
            controls=controls,
        )
    )


def test_a_flight_begins_in_the_state_it_is_told():
    truth = simulation(OpenLoop()).truth
    assert np.degrees(euler_from_quat(truth.q_nb)) == pytest.approx([25.0, 3.0, 40.0])
    assert truth.v_air_b_mps == pytest.approx([35.0, 0.0, 0.1])
    assert np.degrees(truth.omega_b_rps) == pytest.approx([0.0, -7.0, 0.0])
    assert truth.height_agl_m == pytest.approx(500.0, abs=1e-6)


def test_open_loop_controls_stay_as_they_are():
    flight = simulation(OpenLoop(elevator_deg=-3.0, aileron_deg=2.0, throttle=0.4))
    for _ in range(5):
        flight.step()
    throws = np.degrees(flight.vehicle.throw_rad)
    assert flight.controls == pytest.approx([-3.0 / throws[0], 2.0 / throws[1], 0.0, 0.4])


def test_weaving_rolls_from_side_to_side_and_holds_the_airspeed():
    flight = simulation(OpenLoop(elevator_deg=-2.8, throttle=0.46, weave=WEAVE))
    rolls, speeds = [], []
    for _ in range(20 * 250):
        _, truth, _ = flight.step()
        rolls.append(np.degrees(euler_from_quat(truth.q_nb)[0]))
        speeds.append(np.linalg.norm(truth.v_air_b_mps))
    assert max(rolls) == pytest.approx(30.0, abs=6.0)
    assert min(rolls) == pytest.approx(-30.0, abs=6.0)
    assert speeds[-1] == pytest.approx(35.0, abs=3.0)


def test_a_track_takes_the_place_of_open_loop_controls():
    flight = simulation(OpenLoop(elevator_deg=-2.8, throttle=0.46))
    flight.controller.track = CircleTrack(0.0, 0.0, 500.0, 400.0, 35.0)
    for _ in range(10 * 250):
        _, truth, _ = flight.step()
    assert truth.height_agl_m == pytest.approx(500.0, abs=15.0)


def test_controls_and_a_mission_exclude_each_other():
    with pytest.raises(ValueError, match="a fixed wing without a mission"):
        Scenario(controls=OpenLoop(), mission=[Leg(shape="line")])


def test_a_start_state_needs_height():
    with pytest.raises(ValueError, match="state needs a start in the air"):
        Start(state=STATE)
