"""Both vehicles fly every shape in 8 m/s of wind with light gusts.

Limits as the documentation states them: 6 m across the track for the fixed wing, 2 m for the
multirotor; 5 m and 1 m in height.
"""

import math

import numpy as np
import pytest

from simvehicle.guidance.mission import lap_arcs, plan_path, smallest_size
from simvehicle.guidance.route import PathTrack
from simvehicle.scenario.scenario_file import (
    Environment,
    Leg,
    Scenario,
    SensorSuite,
    StartConfig,
    VehicleChoice,
)
from simvehicle.sensors.imu import ImuSensor
from simvehicle.simulation.simulation import Simulation

SHAPES = ["triangle", "diamond", "trapezoid", "s", "eight", "circle", "line"]
WIND = Environment(wind_ned_mps=(5.657, 5.657, 0.0), gusts="light")
# Vehicle, speed [m/s], limits across the track and in height [m], smallest leg [m].
VEHICLES = [
    (VehicleChoice(kind="fixedwing", parameters="aerosonde-2025"), 25.0, 6.0, 5.0, 300.0),
    (VehicleChoice(kind="multirotor", parameters="iris"), 6.0, 2.0, 1.0, 50.0),
]


def size_of(shape: str, speed: float, wind: float, accel: float, least: float) -> float:
    """A size with straights between the corners."""
    radius = (speed + wind) ** 2 / accel
    return max(least, 1.05 * smallest_size(shape, radius))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("choice", "speed", "across", "height", "least"), VEHICLES)
def test_a_shape_is_flown_within_its_limits(
    shape: str, choice: VehicleChoice, speed: float, across: float, height: float, least: float
) -> None:
    accel, wind, rate = (6.87, 8.0, 50.0) if choice.kind == "fixedwing" else (3.0, 0.0, 125.0)
    leg = Leg(
        shape=shape,  # type: ignore[arg-type]
        size_m=size_of(shape, speed, wind, accel, least),
        height_m=80.0,
        speed_mps=speed,
    )
    flight = Scenario(
        start=StartConfig(height_m=80.0),
        vehicle=choice,
        environment=WIND,
        mission=[leg],
        sensors=SensorSuite(imu=ImuSensor(rate_hz=rate)),
    )
    simulation = Simulation(flight)
    track = simulation.controller.track
    assert isinstance(track, PathTrack)
    worst, worst_height = 0.0, 0.0
    for count in range(300 * int(rate)):
        _, truth, _ = simulation.step()
        if track.finished:
            break
        if count % 5 == 0:
            north, east, _ = truth.r_ned_m.tolist()
            worst = max(worst, abs(track.setpoint_from(north, east, 0.0).cross_track_m))
            worst_height = max(worst_height, abs(truth.height_agl_m - 80.0))
    assert track.finished
    assert worst < across
    assert worst_height < height


@pytest.mark.parametrize("shape", ["triangle", "diamond", "trapezoid", "eight", "circle"])
def test_a_closed_shape_ends_at_its_start_with_the_same_heading(shape: str) -> None:
    path = plan_path([Leg(shape=shape, size_m=400.0)], (3.0, 4.0, 0.5), 10.0, 0.0, 5.0)  # type: ignore[arg-type]
    run = len(path.north_m) * path.spacing_m
    length = sum(arc[0] for arc in lap_arcs(shape, 400.0, 20.0))
    assert run == pytest.approx(length, abs=2.0 * path.spacing_m)
    assert math.hypot(path.north_m[-1] - 3.0, path.east_m[-1] - 4.0) < 2.0 * path.spacing_m
    assert math.cos(path.course_rad[-1] - 0.5) > 0.99


@pytest.mark.parametrize("shape", SHAPES)
def test_the_smallest_size_has_no_negative_arc_and_a_smaller_one_does(shape: str) -> None:
    least = smallest_size(shape, 20.0)
    assert min(length for length, _ in lap_arcs(shape, least + 1e-6, 20.0)) > -1e-9
    if shape in ("triangle", "diamond", "trapezoid"):
        assert min(length for length, _ in lap_arcs(shape, 0.99 * least, 20.0)) < 0.0


def test_legs_follow_one_another_without_a_jump() -> None:
    legs = [Leg(shape="s", size_m=100.0, laps=2), Leg(shape="eight", size_m=300.0, height_m=50.0)]
    path = plan_path(legs, (0.0, 0.0, 1.0), 10.0, 0.0, 5.0)
    steps = np.hypot(np.diff(path.north_m), np.diff(path.east_m))
    assert np.all(np.abs(steps - path.spacing_m) < 0.01 * path.spacing_m)
    turned = np.abs(np.diff(path.course_rad))
    assert np.max(turned) <= np.max(np.abs(path.curvature_pm)) * path.spacing_m + 1e-9
    assert set(path.leg) == {0, 1}
    assert set(path.height_m) == {100.0, 50.0}
