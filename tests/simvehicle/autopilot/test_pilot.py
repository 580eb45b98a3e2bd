"""The built-in controllers fly what the services command."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simvehicle.app.sim_server import create_services
from simvehicle.autopilot.enums import FlightMode
from simvehicle.autopilot.flight_goals import CommandedFlight
from simvehicle.autopilot.pilot import Pilot
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.body import Truth

Holds = Callable[[Truth], bool]


class Flown:
    """A vehicle at home, and the flight that commands it."""

    def __init__(self, folder: Path, vehicle: str, more: str = "") -> None:
        path = folder / "vehicle.yaml"
        path.write_text(f"vehicle: {vehicle}\nsensors: {{imu: {{rate_hz: 100}}}}\n{more}")
        self.simulation = Simulation(read_scenario(path))
        self.pilot: Pilot = create_services(self.simulation)[1]
        self.flight: CommandedFlight = self.pilot.flight
        self.flight.advance(self.simulation.truth)

    def until(self, holds: Holds, limit_s: float) -> Truth:
        """Simulate until the truth meets a condition, for at most `limit_s` of simulated time."""
        end_us = self.simulation.truth.t_us + limit_s * 1e6
        while not holds(self.simulation.truth):
            assert self.simulation.truth.t_us < end_us, self.simulation.truth
            _, truth, _ = self.simulation.step(self.pilot.controls())
            self.flight.advance(truth)
        return self.simulation.truth


@pytest.fixture
def quad(tmp_path: Path) -> Flown:
    return Flown(tmp_path, "{kind: multirotor, parameters: iris}")


@pytest.fixture
def wing(tmp_path: Path) -> Flown:
    return Flown(tmp_path, "{kind: fixedwing, parameters: aerosonde-2025}")


def away(truth: Truth, north_m: float, east_m: float) -> float:
    north, east, _ = truth.r_ned_m.tolist()
    return math.hypot(north - north_m, east - east_m)


def place(flown: Flown, north_m: float) -> tuple[float, float]:
    home = flown.flight.home
    return home.lat_deg + north_m / 111_200.0, home.lon_deg


def test_the_multirotor_takes_off_goes_there_returns_and_lands(quad: Flown) -> None:
    flight = quad.flight
    flight.arm()
    flight.take_off(math.nan)
    quad.until(lambda truth: flight.mode is FlightMode.HOLD, 20)
    assert flight.go_to(*place(quad, 25.0), math.nan, math.nan)
    there = quad.until(lambda truth: away(truth, 25.0, 0.0) < 0.5, 30)
    assert there.height_agl_m == pytest.approx(10.0, abs=1.5)
    flight.set_mode(FlightMode.RETURN)
    quad.until(lambda truth: not flight.armed, 120)
    assert away(quad.simulation.truth, 0.0, 0.0) < 2.0
    assert quad.simulation.truth.on_ground


def test_the_multirotor_turns_to_the_heading_it_is_given(quad: Flown) -> None:
    quad.flight.arm()
    quad.flight.take_off(math.nan)
    quad.until(lambda truth: quad.flight.mode is FlightMode.HOLD, 20)
    quad.flight.go_to(*place(quad, 3.0), math.nan, math.radians(90.0))
    quad.until(lambda truth: abs(truth.q_nb[3] - math.sqrt(0.5)) < 0.03, 20)


def test_the_fixed_wing_takes_off_circles_a_place_and_lands(wing: Flown) -> None:
    flight = wing.flight
    flight.arm()
    flight.take_off(math.nan)
    wing.until(lambda truth: flight.mode is FlightMode.HOLD, 60)
    assert flight.go_to(*place(wing, 800.0), flight.home.alt_m + 80.0, math.nan)
    wing.until(lambda truth: away(truth, 800.0, 0.0) < 160.0, 90)
    start_us = wing.simulation.truth.t_us
    wing.until(lambda truth: truth.t_us > start_us + 30_000_000, 31)
    assert away(wing.simulation.truth, 800.0, 0.0) < 160.0
    assert wing.simulation.truth.height_agl_m == pytest.approx(80.0, abs=8.0)
    flight.set_mode(FlightMode.LAND)
    wing.until(lambda truth: not flight.armed, 180)
    assert wing.simulation.truth.on_ground


def test_the_scenarios_mission_is_flown_until_the_first_command(tmp_path: Path) -> None:
    mission = "mission: [{shape: circle, size_m: 400, height_m: 100}]\nstart: {height_m: 100}\n"
    wing = Flown(tmp_path, "{kind: fixedwing, parameters: aerosonde-2025}", mission)
    flight = wing.flight
    assert (flight.mode, flight.armed, flight.goal_active) == (FlightMode.MISSION, True, False)
    track = wing.simulation.controller.track
    for _ in range(200):
        _, truth, _ = wing.simulation.step(wing.pilot.controls() if flight.goal_active else None)
        flight.advance(truth)
    assert wing.simulation.controller.track is track
    flight.set_mode(FlightMode.HOLD)
    assert flight.goal_active
    wing.pilot.controls()
    assert wing.simulation.controller.track is not track


EIGHT = "mission: [{shape: eight, size_m: 600, height_m: 60}]\n"
IN_THE_AIR = "start: {height_m: 60}\n"
COMMANDS: dict[str, Callable[[CommandedFlight], object]] = {
    "arm": lambda flight: flight.arm(),
    "disarm": lambda flight: flight.disarm(force=False),
    "kill": lambda flight: flight.disarm(force=True),
    "take off": lambda flight: flight.take_off(math.nan),
    "current": lambda flight: flight.set_current(1),
    **{mode.name: lambda flight, mode=mode: flight.set_mode(mode) for mode in FlightMode},
}


@pytest.mark.parametrize("more", ["", EIGHT, IN_THE_AIR, EIGHT + IN_THE_AIR])
@settings(max_examples=25)
@given(st.lists(st.sampled_from(sorted(COMMANDS)), max_size=6))
def test_no_order_of_commands_ends_the_flight(
    tmp_path_factory: pytest.TempPathFactory, more: str, commands: list[str]
) -> None:
    vehicle = "{kind: fixedwing, parameters: aerosonde-2025}"
    flown = Flown(tmp_path_factory.mktemp("flight"), vehicle, more)
    for name in commands:
        COMMANDS[name](flown.flight)
        end_us = flown.simulation.truth.t_us + 200_000
        flown.until(lambda truth, end_us=end_us: truth.t_us >= end_us, 1.0)


def test_arming_leaves_the_scenarios_own_mission_to_its_controller(tmp_path: Path) -> None:
    vehicle = "{kind: fixedwing, parameters: aerosonde-2025}"
    flown = Flown(tmp_path, vehicle, EIGHT + IN_THE_AIR)
    flown.flight.arm()
    assert flown.flight.set_mode(FlightMode.MISSION)
    assert not flown.flight.goal_active
    assert flown.flight.disarm(force=False) is False


def test_a_vehicle_killed_on_the_ground_flies_the_scenarios_items_when_armed_again(
    tmp_path: Path,
) -> None:
    line = "mission: [{shape: line, size_m: 30, height_m: 10}]\n"
    flown = Flown(tmp_path, "{kind: multirotor, parameters: iris}", line)
    flown.flight.disarm(force=True)
    flown.until(lambda truth: truth.t_us >= 500_000, 1.0)
    flown.flight.arm()
    assert flown.flight.mode == FlightMode.MISSION
    flown.until(lambda truth: away(truth, 30.0, 0.0) < 2.5, 60.0)
