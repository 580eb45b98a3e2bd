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


def test_a_change_acts_until_it_is_taken_back(simulation: Simulation) -> None:
    changes = PlantChanges(simulation, print)
    changes.carry_out(frame("wind_n_mps", 5.0))
    assert simulation.step()[1].wind_ned_mps[0] == 5.0
    changes.carry_out(frame("wind_n_mps", None))
    assert simulation.step()[1].wind_ned_mps[0] == 0.0


def test_what_cannot_be_changed_is_told_once_and_the_flight_goes_on(
    simulation: Simulation,
) -> None:
    told: list[str] = []
    changes = PlantChanges(simulation, told.append)
    for _ in range(3):
        changes.carry_out(frame("warp_drive", 9.0))
    assert len(told) == 1
    assert "warp_drive is unknown" in told[0]


def test_other_frames_are_none_of_its_business(simulation: Simulation) -> None:
    layout = message_layout("HEARTBEAT")
    PlantChanges(simulation, print).carry_out(Frame(build_frame(layout, {"type": 6}), layout))
