from pathlib import Path

import pytest

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.plant_messages import PlantChange, plant_frame
from simvehicle.hil.plant_changes import PlantChanges
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation


@pytest.fixture
def simulation(tmp_path: Path) -> Simulation:
    path = tmp_path / "quad.yaml"
    path.write_text("vehicle: {kind: multirotor, parameters: iris}")
    return Simulation(read_scenario(path))


def frame(name: str, value: float | None) -> Frame:
    return Frame(plant_frame(PlantChange(name, value)), message_layout("TUNNEL"))


def test_a_plant_fault_acts_until_it_is_removed(simulation: Simulation) -> None:
    changes = PlantChanges(simulation.plant, print)
    changes.carry_out(frame("wind_n_mps", 5.0))
    assert simulation.step()[1].wind_ned_mps[0] == 5.0
    changes.carry_out(frame("wind_n_mps", None))
    assert simulation.step()[1].wind_ned_mps[0] == 0.0


def test_an_impossible_plant_fault_is_reported_once_and_the_flight_continues(
    simulation: Simulation,
) -> None:
    reported: list[str] = []
    changes = PlantChanges(simulation.plant, reported.append)
    for _ in range(3):
        changes.carry_out(frame("warp_drive", 9.0))
    assert len(reported) == 1
    assert "warp_drive is unknown" in reported[0]


def test_other_frames_are_ignored(simulation: Simulation) -> None:
    layout = message_layout("HEARTBEAT")
    PlantChanges(simulation.plant, print).carry_out(Frame(build_frame(layout, {"type": 6}), layout))
