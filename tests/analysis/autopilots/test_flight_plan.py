"""The flight plan of a scenario for an autopilot."""

import itertools
import math

import numpy as np
import pytest

from analysis.autopilots.flight_plan import flight_plan
from simvehicle.guidance.waypoints import simplify_path
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation

M_PER_DEG = 111_320.0


def plan(tmp_path, text):
    file = tmp_path / "scenario.yaml"
    file.write_text(f"name: it\nduration_s: 60\nsensors: {{imu: {{}}}}\n{text}")
    return flight_plan(Simulation(read_scenario(str(file))))


def test_without_a_mission_a_quad_hovers(tmp_path):
    found = plan(tmp_path, "vehicle: {kind: multirotor, parameters: iris}")
    assert (found.height_m, found.duration_s) == (10.0, 60.0)
    assert found.waypoints == found.landing == ()


def test_a_mission_becomes_waypoints_with_its_speed(tmp_path):
    found = plan(
        tmp_path,
        "vehicle: {kind: multirotor, parameters: iris}\n"
        "mission: [{shape: line, size_m: 100, height_m: 20, speed_mps: 4}]",
    )
    assert found.height_m == 20.0
    assert {point.speed_mps for point in found.waypoints} == {4.0}
    north_m = [(p.lat_deg - found.waypoints[0].lat_deg) * M_PER_DEG for p in found.waypoints]
    assert north_m[:-1] == pytest.approx([20.0 * n for n in range(len(north_m) - 1)], abs=1.0)
    assert north_m[-1] == pytest.approx(100.0, abs=1.0)


@pytest.mark.parametrize("shape", ["trapezoid", "triangle", "circle", "eight", "s"])
def test_the_legs_between_waypoints_follow_the_path(tmp_path, shape):
    file = tmp_path / "scenario.yaml"
    file.write_text(
        "name: it\nduration_s: 60\nsensors: {imu: {}}\n"
        "vehicle: {kind: multirotor, parameters: iris}\n"
        f"mission: [{{shape: {shape}, size_m: 60, height_m: 20, speed_mps: 4}}]"
    )
    simulation = Simulation(read_scenario(str(file)))
    path = simulation.controller.track.path
    places = path.north_m + 1j * path.east_m
    chosen = simplify_path(path, 20.0, 1.0)
    assert (chosen[0], chosen[-1]) == (0, len(places) - 1)
    for first, last in itertools.pairwise(chosen):
        assert (last - first) * path.spacing_m < 20.0 + path.spacing_m
        along = np.linspace(places[first], places[last], 200)
        off_m = np.abs(places[first : last + 1, None] - along).min(axis=1)
        assert off_m.max() < 1.1


def test_a_plane_lands_where_it_took_off_in_the_same_direction(tmp_path):
    found = plan(
        tmp_path,
        "vehicle: {kind: fixedwing, parameters: aerosonde-2025}\n"
        "start: {lat_deg: 47.0, lon_deg: 8.0, alt_m: 400, heading_deg: 90}",
    )
    approach, threshold = found.landing
    assert (threshold.lat_deg, threshold.lon_deg, threshold.height_m) == (47.0, 8.0, 0.0)
    assert approach.height_m == found.height_m == 50.0
    east_m = (approach.lon_deg - 8.0) * M_PER_DEG * math.cos(math.radians(47.0))
    assert east_m == pytest.approx(-1000.0, abs=5.0)
    assert approach.lat_deg == pytest.approx(47.0)
