"""A new kind of vehicle is a module with a `KindDefinition`; here, a stone."""

from typing import Any

import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from simvehicle.app.sim_server import mav_type_and_mix, throttle_command
from simvehicle.autopilot.enums import MavType
from simvehicle.scenario.scenario_file import Scenario, StartConfig, VehicleChoice
from simvehicle.simulation import vehicle_kinds
from simvehicle.simulation.simulation import Simulation
from simvehicle.simulation.vehicle_kinds import KindDefinition, find_vehicle_kind
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.vehicle import DENSITY, GRAVITY


class Material:
    cruise_mps = 1.0


class Stone:
    """It falls; the state is that of a rigid body."""

    controls_count = 1
    plant_names = ()
    standing_height_m = 0.1

    def __init__(self, name: str) -> None:
        self.parameters = Material()

    def with_plant(self, plant: Any) -> "Stone":
        return self

    def start(self, r: np.ndarray, v: np.ndarray, q: np.ndarray) -> np.ndarray:
        return np.concatenate([r, v, q, np.zeros(3)])

    def cruise(self, r: np.ndarray, *_: Any) -> np.ndarray:
        return self.start(r, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))

    def advance(
        self, x: np.ndarray, controls: Any, surroundings: np.ndarray, steps: int, dt: float
    ) -> tuple[np.ndarray, np.ndarray]:
        after = x.copy()
        after[3:6] += surroundings[GRAVITY:DENSITY] * steps * dt
        after[:3] += 0.5 * (x[3:6] + after[3:6]) * steps * dt
        return after, np.zeros(6)


class NoController:
    """Steers nothing."""

    rate_hz, drifts, lateral_mps2 = 10.0, False, 1.0
    landing = False
    track = None

    def update(self, truth: Truth) -> Controls:
        return Controls(np.zeros(1))

    def circle(self, *_: float) -> Any:
        raise NotImplementedError


STONE = KindDefinition(
    read=Stone,
    controller=lambda *_: NoController(),
    mav_type=lambda _: MavType.FIXED_WING,
    mix=lambda _: lambda channels: np.array(channels[:1]),
    actuators=lambda _: ["nothing"],
    motors=lambda _: 0,
    throttle=lambda controls: float(controls[0]),
    parameters={},
)


def test_a_custom_kind_is_simulated_with_the_usual_sensors_and_links(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(vehicle_kinds.VEHICLE_KINDS, "stone", STONE)
    choice = VehicleChoice(kind="stone", parameters="granite")
    simulation = Simulation(Scenario(start=StartConfig(height_m=50.0), vehicle=choice))
    for _ in range(250):
        t_us, truth, _ = simulation.step()
    assert truth.height_agl_m == pytest.approx(50.0 - 0.5 * 9.807 * (t_us * 1e-6) ** 2, abs=0.01)
    assert simulation.board.sensors["fresh"].any()
    assert mav_type_and_mix(simulation)[0] == MavType.FIXED_WING
    assert throttle_command(simulation) == 0.0


def test_an_unknown_kind_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"vehicle.kind = boat is unknown; known: fixedwing, mul"):
        find_vehicle_kind("boat")
