"""Standing, taking off and landing."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from simvehicle.scenario.scenario_file import (
    Environment,
    Scenario,
    SensorSuite,
    VehicleChoice,
    read_scenario,
)
from simvehicle.sensors.imu import ImuSensor
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.body import Controls

QUAD = VehicleChoice(kind="multirotor", parameters="iris")
HEXA = VehicleChoice(kind="multirotor", parameters="hexa")
WING = VehicleChoice(kind="fixedwing", parameters="aerosonde-2025")


def standing(choice: VehicleChoice, wind: float = 0.0) -> Simulation:
    """A vehicle on the ground, after two seconds with its motors off."""
    simulation = Simulation(
        Scenario(
            vehicle=choice,
            environment=Environment(wind_ned_mps=(wind, 0.0, 0.0)),
            sensors=SensorSuite(imu=ImuSensor(rate_hz=125.0)),
        )
    )
    idle = Controls(np.zeros(simulation.vehicle.controls_count), armed=False)
    for _ in range(250):
        simulation.step(idle)
    return simulation


def fly(simulation: Simulation, seconds: float) -> None:
    """Simulate with the built-in controller."""
    for _ in range(round(seconds * 125)):
        simulation.step()


@pytest.mark.parametrize("choice", [QUAD, HEXA, WING])
def test_a_vehicle_stands_still_and_feels_its_weight(choice: VehicleChoice) -> None:
    truth = standing(choice, wind=2.0).truth
    assert truth.on_ground
    assert np.linalg.norm(truth.v_ned_mps) < 0.05
    assert np.allclose(truth.specific_force_b_mps2, [0.0, 0.0, -9.81], atol=0.3)
    assert abs(truth.height_agl_m - Simulation(Scenario(vehicle=choice)).truth.height_agl_m) < 0.02


@pytest.mark.parametrize("choice", [QUAD, HEXA])
def test_a_multirotor_takes_off_hovers_and_lands(choice: VehicleChoice) -> None:
    simulation = standing(choice)
    controller = simulation.controller
    controller.track = controller.circle(5.0, -3.0, 10.0, 4.0)
    fly(simulation, 20.0)
    truth = simulation.truth
    assert np.allclose(truth.r_ned_m, [5.0, -3.0, -10.0], atol=0.3)
    assert np.linalg.norm(truth.v_ned_mps) < 0.1
    assert 0.9 < truth.battery_remaining < 1.0
    controller.landing = True
    fly(simulation, 15.0)
    assert simulation.truth.on_ground
    assert np.all(simulation.controls == 0.0)


def test_a_fixed_wing_takes_off_circles_and_lands() -> None:
    simulation = standing(WING, wind=2.0)
    controller = simulation.controller
    controller.track = controller.circle(0.0, 0.0, 30.0, 25.0)
    fly(simulation, 40.0)
    assert simulation.truth.height_agl_m == pytest.approx(30.0, abs=3.0)
    controller.landing = True
    fly(simulation, 45.0)
    assert simulation.truth.on_ground
    assert np.linalg.norm(simulation.truth.v_ned_mps) < 0.3


def test_the_example_mission_takes_off_and_flies_its_first_leg() -> None:
    example = Path(__file__).parents[3] / "examples" / "quad_mission.yaml"
    scenario = msgspec.structs.replace(read_scenario(example), gnss=None)
    simulation = Simulation(scenario)
    assert simulation.truth.height_agl_m < 0.2
    kinds = set()
    for _ in range(12 * 250):
        _, truth, readings = simulation.step()
        kinds |= {(type(reading).__name__, getattr(reading, "id", 0)) for reading in readings}
    assert truth.height_agl_m == pytest.approx(20.0, abs=2.0)
    assert {("FlowReading", 0), ("VisionReading", 0)} <= kinds
    assert set(simulation.board.sensors["id"]) == {0, 1}


def test_a_stopped_motor_brings_a_quad_down() -> None:
    simulation = standing(QUAD)
    controller = simulation.controller
    controller.track = controller.circle(0.0, 0.0, 10.0, 4.0)
    fly(simulation, 10.0)
    simulation.plant("motor_efficiency[2]", 0.0)
    fly(simulation, 6.0)
    assert simulation.truth.height_agl_m < 5.0


def test_a_heavier_load_needs_more_thrust_and_current() -> None:
    simulation = standing(QUAD)
    controller = simulation.controller
    controller.track = controller.circle(0.0, 0.0, 10.0, 4.0)
    fly(simulation, 12.0)
    before = simulation.truth.battery_a
    simulation.plant("mass_kg_add", 0.3)
    fly(simulation, 8.0)
    assert simulation.truth.battery_a > 1.15 * before
    assert simulation.truth.height_agl_m == pytest.approx(10.0, abs=0.5)


def test_a_shifted_load_makes_the_motors_differ() -> None:
    simulation = standing(QUAD)
    controller = simulation.controller
    controller.track = controller.circle(0.0, 0.0, 10.0, 4.0)
    simulation.plant("load_shift_x_m", 0.02)
    fly(simulation, 15.0)
    front, rear = simulation.controls[[0, 2]].mean(), simulation.controls[[1, 3]].mean()
    assert front > rear + 0.02


def test_a_weak_battery_lowers_the_voltage_under_load() -> None:
    simulation = standing(QUAD)
    controller = simulation.controller
    controller.track = controller.circle(0.0, 0.0, 10.0, 4.0)
    fly(simulation, 8.0)
    before = simulation.truth.battery_v
    simulation.plant("battery_resistance_scale", 4.0)
    fly(simulation, 4.0)
    assert simulation.truth.battery_v < before - 0.5
