"""Faults that follow from physics: vibration of rotors, fields of currents, warm sensors."""

import numpy as np
import pytest

from simvehicle.scenario.scenario_file import Scenario, SensorSuite, StartConfig, VehicleChoice
from simvehicle.sensors.airspeed import Airspeed
from simvehicle.sensors.barometer import Barometer
from simvehicle.sensors.imu import ImuSensor
from simvehicle.sensors.magnetometer import Magnetometer
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.rigidbody_kernel import RIGID_SIZE

RATE_HZ = 1000.0
UNBALANCE_KGM = 1e-5
SUITE = SensorSuite(
    imu=ImuSensor(rate_hz=RATE_HZ, gyro_per_k=(1e-3, 0.0, -1e-3), accel_per_k=(0.0, 0.02, 0.0)),
    mag=Magnetometer(field_ned_gauss=(0.2, 0.0, 0.4)),
    baro=Barometer(drift_pa_per_k=3.0),
    airspeed=Airspeed(drift_pa_per_k=0.5),
)
HOVER = Scenario(
    vehicle=VehicleChoice(kind="multirotor", parameters="iris"),
    start=StartConfig(height_m=20.0),
    sensors=SUITE,
)


def fly(*plant: tuple[str, float], steps: int = 1000) -> Simulation:
    """A hover with plant faults from the start."""
    simulation = Simulation(HOVER)
    for fault in plant:
        simulation.plant(*fault)
    for _ in range(steps):
        simulation.step()
    return simulation


def shaking(name: str, value: float) -> tuple[np.ndarray, float]:
    """The specific force of 2 s (n, 3) less that of a healthy hover, and the rotor's speed [Hz]."""
    healthy, faulty = Simulation(HOVER), Simulation(HOVER)
    faulty.plant(name, value)
    forces = np.empty((2000, 3))
    for row in forces:
        healthy.step()
        faulty.step()
        row[:] = faulty.truth.specific_force_b_mps2 - healthy.truth.specific_force_b_mps2
    return forces, float(faulty.board.flight[0]["x"][RIGID_SIZE]) / (2.0 * np.pi)


def peak_hz(series: np.ndarray) -> float:
    """The frequency of the strongest line."""
    spectrum = np.abs(np.fft.rfft(series - series.mean()))
    return float(np.fft.rfftfreq(len(series), 1.0 / RATE_HZ)[spectrum.argmax()])


def test_an_unbalanced_rotor_shakes_at_its_speed_with_its_centrifugal_force() -> None:
    forces, speed_hz = shaking("rotor_unbalance_kgm[0]", UNBALANCE_KGM)
    assert np.all(forces[:, 2] == 0.0)
    for axis in range(2):
        assert peak_hz(forces[:, axis]) == pytest.approx(speed_hz, abs=1.0)
    # U omega^2 / m, less what the mean over a step of 1 ms attenuates (sin(a) / a).
    omega = 2.0 * np.pi * speed_hz
    half = 0.5 * omega / RATE_HZ
    expected = UNBALANCE_KGM * omega**2 / 1.5 * np.sin(half) / half
    assert np.sqrt(2.0 * np.mean(forces[:, 0] ** 2)) == pytest.approx(expected, rel=0.02)


def test_a_rotors_ripple_shakes_along_its_axis_at_twice_its_speed() -> None:
    forces, speed_hz = shaking("thrust_ripple[1]", 0.3)
    assert np.all(forces[:, :2] == 0.0)
    assert peak_hz(forces[:, 2]) == pytest.approx(2.0 * speed_hz, abs=1.5)


def test_the_compass_reads_the_field_of_the_batterys_current() -> None:
    healthy, faulty = fly(), fly(("compass_y_gauss_per_a", 0.005))
    field = faulty.board.sensors[1]["values"] - healthy.board.sensors[1]["values"]
    assert faulty.truth.battery_a > 10.0
    assert field[1] == pytest.approx(0.005 * faulty.truth.battery_a, rel=0.01)
    assert field[0] == field[2] == 0.0


def test_warm_sensors_err_by_their_coefficients_and_recover() -> None:
    healthy, faulty = fly(), fly(("sensor_warming_k", 20.0))
    change = faulty.board.sensors["values"] - healthy.board.sensors["values"]
    assert change[0] == pytest.approx([0.0, 0.4, 0.0, 0.02, 0.0, -0.02], abs=1e-12)
    assert change[2, 0] == pytest.approx(60.0)
    assert change[2, 2] == pytest.approx(20.0)
    assert change[3, 0] == pytest.approx(10.0)
    faulty.plant("sensor_warming_k", None)
    for simulation in (healthy, faulty):
        for _ in range(20):
            simulation.step()
    assert np.array_equal(faulty.board.sensors["values"], healthy.board.sensors["values"])
