"""A complete flight: reproducible readings, separate streams, plant faults, the built-in demo."""

from typing import Any

import msgspec
import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from simvehicle.scenario.scenario_file import (
    Environment,
    Leg,
    Scenario,
    SensorSuite,
    StartConfig,
    read_scenario,
)
from simvehicle.sensors.barometer import Barometer
from simvehicle.sensors.compiled_sensor import BARO, IMU
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.gps import Gps
from simvehicle.sensors.imu import ImuSensor
from simvehicle.sensors.readings import GpsReading
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.body import Controls

IN_THE_AIR = StartConfig(height_m=100.0)
NOISY = ImuSensor(rate_hz=100.0, gyro=NoiseModel(sigma=0.01), accel=NoiseModel(sigma=0.1))


def scenario(**changes: Any) -> Scenario:
    """A short straight flight with a few sensors."""
    plain: dict[str, Any] = {
        "start": IN_THE_AIR,
        "mission": [Leg(shape="line", size_m=1000.0, speed_mps=25.0)],
        "sensors": SensorSuite(
            imu=NOISY, baro=Barometer(rate_hz=20.0, noise=NoiseModel(sigma=2.0))
        ),
        "environment": Environment(wind_ned_mps=(1.0, 2.0, 0.0), gusts="light"),
    }
    return Scenario(**{**plain, **changes})


def imu_of(flight: Scenario, count: int = 300, seed: int | None = None) -> np.ndarray:
    """Gyro samples of the first steps."""
    simulation, found = Simulation(flight, seed), []
    for _ in range(count):
        simulation.step()
        found.append(simulation.board.sensors["values"][0, 3:].copy())
    return np.array(found)


def test_the_same_seed_gives_the_same_readings() -> None:
    assert np.array_equal(imu_of(scenario()), imu_of(scenario()))


def test_a_prepared_step_is_the_same() -> None:
    plain, ahead = Simulation(scenario()), Simulation(scenario())
    for _ in range(50):
        ahead.prepare()
        ahead.prepare()  # may be called repeatedly
        ahead.step()
        plain.step()
        assert np.array_equal(ahead.board.sensors["values"], plain.board.sensors["values"])
    assert np.array_equal(ahead.truth.wind_ned_mps, plain.truth.wind_ned_mps)


def test_another_seed_gives_different_readings() -> None:
    assert not np.array_equal(imu_of(scenario()), imu_of(scenario(), seed=2))


def test_adding_a_sensor_does_not_change_the_noise_of_the_others() -> None:
    more = scenario(sensors=SensorSuite(imu=NOISY, gps=Gps(rate_hz=5.0)))
    assert np.array_equal(imu_of(scenario()), imu_of(more))


def test_timestamps_start_above_zero_and_follow_the_imu_rate() -> None:
    simulation = Simulation(scenario())
    stamps = [simulation.step()[0] for _ in range(3)]
    assert stamps == [10_000, 20_000, 30_000]


def test_each_sensor_samples_at_its_own_rate() -> None:
    simulation, kinds = Simulation(scenario()), []
    for _ in range(100):
        simulation.step()
        sensors = simulation.board.sensors
        kinds += sensors["kind"][sensors["fresh"] == 1].tolist()
    assert kinds.count(IMU) == 100
    assert kinds.count(BARO) == 20


def test_a_sensor_with_latency_delivers_old_samples() -> None:
    late = scenario(sensors=SensorSuite(imu=NOISY, gps=Gps(rate_hz=10.0, latency_s=0.1)))
    simulation, truths, fixes = Simulation(late), {}, []
    for _ in range(50):
        t_us, truth, readings = simulation.step()
        truths[t_us] = truth
        fixes += [r for r in readings if isinstance(r, GpsReading)]
    assert len(fixes) >= 3
    fix = fixes[2]
    assert fix.lat_deg == pytest.approx(np.degrees(truths[fix.t_us - 100_000].lat_rad), abs=1e-12)


def test_the_demo_flies_its_path_at_height_and_speed() -> None:
    demo = msgspec.structs.replace(read_scenario(None), gnss=None)
    simulation = Simulation(demo)
    errors, heights = [], []
    for count in range(60 * 250):
        _, truth, _ = simulation.step()
        if count % 25 == 0:
            north, east, _ = truth.r_ned_m
            assert simulation.controller.track is not None
            errors.append(simulation.controller.track.setpoint_from(north, east, 0.0).cross_track_m)
            heights.append(truth.height_agl_m)
    assert np.max(np.abs(errors)) < 5.0
    assert np.max(np.abs(np.array(heights) - 100.0)) < 5.0


def test_external_controls_fly_the_vehicle() -> None:
    simulation = Simulation(scenario())
    for _ in range(100):
        _, truth, _ = simulation.step(Controls(np.array([0.0, 1.0, 0.0, 0.5])))
    assert truth.omega_b_rps[0] > 1.0


def test_the_controls_of_a_step_stay_as_they_were() -> None:
    simulation = Simulation(scenario())
    simulation.step(Controls(np.array([0.0, 1.0, 0.0, 0.5])))
    flown = simulation.controls
    simulation.step(Controls(np.zeros(4)))
    assert flown.tolist() == [0.0, 1.0, 0.0, 0.5]


def test_an_unarmed_vehicle_gets_no_thrust() -> None:
    flown = Simulation(scenario())
    for _ in range(200):
        _, truth, _ = flown.step(Controls(np.array([0.0, 0.0, 0.0, 1.0]), armed=False))
    assert np.linalg.norm(truth.v_air_b_mps) < 24.0


def test_wind_as_a_plant_fault_moves_the_vehicle_and_ends() -> None:
    simulation = Simulation(scenario(environment=Environment()))
    simulation.plant("wind_e_mps", 8.0)
    _, truth, _ = simulation.step()
    assert truth.wind_ned_mps[1] == 8.0
    simulation.plant("wind_e_mps", None)
    _, truth, _ = simulation.step()
    assert truth.wind_ned_mps[1] == 0.0


def test_a_dead_motor_slows_the_vehicle_down() -> None:
    healthy, faulty = Simulation(scenario()), Simulation(scenario())
    faulty.plant("motor_efficiency[0]", 0.0)
    for _ in range(300):
        _, good, _ = healthy.step()
        _, bad, _ = faulty.step()
    assert np.linalg.norm(bad.v_air_b_mps) < np.linalg.norm(good.v_air_b_mps) - 2.0


def test_an_unknown_plant_fault_names_the_known_ones() -> None:
    with pytest.raises(
        ConfigError, match="inertia_scal is unknown to this fixedwing; known: mass_kg_add"
    ):
        Simulation(scenario()).plant("inertia_scal", 2.0)


def test_a_body_that_cannot_exist_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"mass_kg_add = -100.0 is impossible"):
        Simulation(scenario()).plant("mass_kg_add", -100.0)


def test_nan_controls_are_an_error() -> None:
    simulation = Simulation(scenario())
    with pytest.raises(ConfigError, match="4 finite numbers are needed"):
        simulation.step(Controls(np.full(4, np.nan)))


def test_a_diverging_state_is_an_error() -> None:
    simulation = Simulation(scenario())
    simulation.plant("wind_e_mps", 1e200)
    with pytest.raises(ConfigError, match="simulation diverged at 0"):
        simulation.step()


def test_a_shape_too_small_for_the_wind_is_refused_with_the_size_that_fits() -> None:
    small = scenario(mission=[Leg(shape="triangle", size_m=50.0, speed_mps=25.0)])
    with pytest.raises(ConfigError, match=r"mission\[0\].size_m = 50 is too small for a triangle"):
        Simulation(small)


def test_a_speed_below_stall_is_refused() -> None:
    slow = scenario(mission=[Leg(shape="line", size_m=500.0, speed_mps=5.0)])
    with pytest.raises(ConfigError, match=r"mission\[0\].speed_mps = 5 cannot be flown"):
        Simulation(slow)
