"""Parameter files: the shipped ones are valid, invalid ones are refused with line and reason."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from simvehicle.scenario.scenario_file import Scenario, VehicleChoice, read_scenario
from simvehicle.simulation.simulation import Simulation
from simvehicle.simulation.vehicle_kinds import find_vehicle_kind
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.multirotor.multirotor import Multirotor

SHIPPED = Path(str(resources.files("simvehicle.vehicles") / "parameters"))
WINGS = ["aerosonde-2012", "aerosonde-2025", "aerosonde-2025-matlab", "zagi-2012"]


@pytest.mark.parametrize("name", [*WINGS, "aerosonde-2025-thrust-law"])
def test_every_shipped_wing_names_its_source(name: str) -> None:
    parameters = FixedWing.read(name).parameters
    assert parameters.name == name
    assert "Beard and McLain" in parameters.source or "mavsim_public" in parameters.source


@pytest.mark.parametrize(("name", "motors"), [("iris", 4), ("hexa", 6)])
def test_every_shipped_multirotor_can_hover_and_turn_both_ways(name: str, motors: int) -> None:
    vehicle = Multirotor.read(name)
    assert vehicle.controls_count == motors
    assert abs(np.sum(vehicle.rotors[:, 2])) < 1e-12
    assert np.allclose(np.sum(vehicle.rotors[:, :2], axis=0), 0.0, atol=0.05)
    motor = vehicle.parameters.motor
    lift = motors * motor.thrust_n_per_rps2 * motor.full_rps**2
    assert lift > 1.5 * 9.81 * vehicle.parameters.mass_kg


def test_an_unknown_set_names_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"vehicle.parameters: cessna is unknown; known: aeros"):
        find_vehicle_kind("fixedwing").read("cessna")


def test_a_set_of_another_kind_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"aerosonde-2025.yaml:[0-9]+: [a-z_]+ is unknown; known: "
    ):
        find_vehicle_kind("multirotor").read("aerosonde-2025")


def edited(tmp_path: Path, name: str, old: str, new: str) -> Path:
    """A shipped file with one edit."""
    text = (SHIPPED / f"{name}.yaml").read_text()
    assert old in text
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace(old, new))
    return path


WRONG = [
    (
        "aerosonde-2025",
        "mass_kg: 11.0",
        "mass_kg: heavy",
        r"mine.yaml:5: mass_kg = 'heavy' does not fit",
    ),
    ("aerosonde-2025", "mass_kg: 11.0\n", "", r"mine.yaml:2: lacks mass_kg"),
    ("aerosonde-2025", "mass_kg: 11.0", "mass_kg: -1.0", "is no rigid body"),
    ("aerosonde-2025", "jy: 1.135", "jy: 9.0", "is no rigid body"),
    ("iris", "jz: 0.055225", "jz: 0.5", r"mine.yaml:2: mass 1.5 kg .* no rigid"),
    ("aerosonde-2025", "motor:", "engine:", r"engine is unknown"),
    ("aerosonde-2012", "thrust_law:", "# ", "exactly one of thrust_law and motor is needed"),
    ("iris", "idle_rps: 100.0", "idle_rps: 2000.0", "idle_rps must lie between 0 and motor.full"),
    (
        "iris",
        "turns: cw}",
        "turns: left}",
        r"rotors\[2\].turns = 'left' is unknown; known: ccw, cw",
    ),
]


@pytest.mark.parametrize(("name", "old", "new", "message"), WRONG)
def test_a_wrong_file_is_refused(
    tmp_path: Path, name: str, old: str, new: str, message: str
) -> None:
    kind = "multirotor" if name == "iris" else "fixedwing"
    with pytest.raises(ConfigError, match=message):
        find_vehicle_kind(kind).read(str(edited(tmp_path, name, old, new)))


def test_a_scenario_finds_a_vehicle_file_in_its_folder(tmp_path: Path) -> None:
    edited(tmp_path, "aerosonde-2025", "mass_kg: 11.0", "mass_kg: 12.0")
    path = tmp_path / "flight.yaml"
    path.write_text("vehicle: {kind: fixedwing, parameters: mine.yaml}\n")
    vehicle = Simulation(read_scenario(path)).vehicle
    assert isinstance(vehicle, FixedWing)
    assert vehicle.body.mass_kg == 12.0


def test_a_multirotor_needs_four_rotors(tmp_path: Path) -> None:
    path = edited(tmp_path, "iris", "  - {x_m: -0.13, y_m: 0.20, turns: cw}\n", "")
    with pytest.raises(ConfigError, match="3 rotors are not supported; use 4 to 8"):
        find_vehicle_kind("multirotor").read(str(path))


@pytest.mark.parametrize("kind", ["fixedwing", "multirotor"])
def test_every_plant_fault_of_a_vehicle_can_be_switched_on_and_off(kind: str) -> None:
    name = "aerosonde-2025" if kind == "fixedwing" else "iris"
    simulation = Simulation(Scenario(vehicle=VehicleChoice(kind=kind, parameters=name)))  # type: ignore[arg-type]
    for fault in simulation.vehicle.plant_names:
        simulation.plant(fault, 0.5)
        simulation.step()
        simulation.plant(fault, None)
    simulation.step()
    assert np.all(np.isfinite(simulation.truth.r_ned_m))
