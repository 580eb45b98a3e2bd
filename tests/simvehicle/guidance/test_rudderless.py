"""The Zagi, without a rudder and with little yaw stiffness, needs its own controller.

Limits as the documentation states them: 30 m across the track and 5 m in height.
"""

import math

import numpy as np
import pytest

from simvehicle.guidance.fixedwing_controller import FixedWingController
from simvehicle.guidance.route import PathTrack
from simvehicle.guidance.rudderless_controller import RudderlessController, has_rudder
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
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing

WIND = Environment(wind_ned_mps=(3.0, 3.0, 0.0), gusts="light")


def zagi(leg: Leg, weather: Environment, height_m: float = 80.0) -> Simulation:
    return Simulation(
        Scenario(
            start=StartConfig(height_m=height_m),
            vehicle=VehicleChoice(kind="fixedwing", parameters="zagi-2012"),
            environment=weather,
            mission=[leg],
            sensors=SensorSuite(imu=ImuSensor(rate_hz=50.0)),
        )
    )


@pytest.mark.parametrize(
    ("shape", "size", "weather"),
    [("eight", 1300.0, Environment()), ("circle", 600.0, WIND), ("s", 500.0, WIND)],
)
def test_the_zagi_flies_shapes_within_its_limits(
    shape: str, size: float, weather: Environment
) -> None:
    leg = Leg(shape=shape, size_m=size, height_m=80.0, speed_mps=17.0)  # type: ignore[arg-type]
    simulation = zagi(leg, weather)
    track = simulation.controller.track
    assert isinstance(track, PathTrack)
    across, height, slip = [], [], []
    while not track.finished and simulation.truth.t_us < 250_000_000:
        _, truth, _ = simulation.step()
        north, east, _ = truth.r_ned_m.tolist()
        across.append(track.setpoint_from(north, east, 0.0).cross_track_m)
        height.append(truth.height_agl_m - 80.0)
        slip.append(truth.v_air_b_mps[1] / np.linalg.norm(truth.v_air_b_mps))
    assert track.finished
    assert np.abs(across).max() < 30.0
    assert np.abs(height).max() < 5.0
    assert np.degrees(np.abs(slip)).max() < 20.0


def test_the_zagi_takes_off_and_climbs_to_its_circle() -> None:
    leg = Leg(shape="circle", size_m=600.0, height_m=40.0, speed_mps=17.0)
    simulation = zagi(leg, WIND, height_m=0.0)
    for _ in range(40 * 50):
        _, truth, _ = simulation.step()
    assert truth.height_agl_m == pytest.approx(40.0, abs=5.0)
    assert np.linalg.norm(truth.v_air_b_mps) == pytest.approx(17.0, abs=3.0)


def test_a_steady_turn_of_its_linear_model_is_an_equilibrium() -> None:
    vehicle = FixedWing.read("zagi-2012")
    controller = RudderlessController(vehicle, 1.2, 0.0)
    point = controller.trim(17.0)
    gains, turn, aileron = controller._regulator(point)
    assert turn[1] == 1.0  # per radian of bank
    assert turn[3] == pytest.approx(9.80665 / 17.0, rel=0.05)  # yaw rate of a gentle turn
    assert np.isfinite([*gains, aileron]).all()


def test_only_airframes_without_a_rudder_use_this_controller() -> None:
    assert not has_rudder(FixedWing.read("zagi-2012"))
    assert has_rudder(FixedWing.read("aerosonde-2025"))
    line = Leg(shape="line", size_m=500.0)
    assert type(zagi(line, WIND).controller) is RudderlessController
    plain = Simulation(Scenario(start=StartConfig(height_m=80.0), mission=[line]))
    assert type(plain.controller) is FixedWingController
    assert math.degrees(plain.controller.bank_limit) > 45.0
