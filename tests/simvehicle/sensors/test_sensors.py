"""Sensors: without noise they equal the truth; with noise they have the configured statistics."""

from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from mavproxy_fault.documents.document_check import decode
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import Document
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat, quat_from_euler
from simvehicle.environment.air import pressure_altitude
from simvehicle.sensors.airspeed import Airspeed
from simvehicle.sensors.barometer import Barometer
from simvehicle.sensors.battery import BatteryMonitor
from simvehicle.sensors.compiled_sensor import CompiledSensor
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.flight_record import FLIGHT, SENSOR
from simvehicle.sensors.flow import OpticalFlow
from simvehicle.sensors.gps import Gps, GpsError
from simvehicle.sensors.imu import ImuSensor
from simvehicle.sensors.magnetometer import Magnetometer
from simvehicle.sensors.rangefinder import Rangefinder
from simvehicle.sensors.readings import (
    BatteryReading,
    FlowReading,
    GpsReading,
    RangeReading,
    VisionReading,
)
from simvehicle.sensors.vision import Vision
from simvehicle.simulation.onboard_sensors import CompiledOnboardSensor
from simvehicle.simulation.step_kernel import measure
from simvehicle.vehicles.body import Truth

FIELD = (0.21, 0.01, 0.43)
TRUTH = Truth(
    t_us=1_000_000,
    lat_rad=0.8,
    lon_rad=0.15,
    height_m=530.0,
    alt_msl_m=520.0,
    height_agl_m=20.0,
    r_ned_m=np.array([10.0, -20.0, -20.0]),
    v_ned_mps=np.array([20.0, 5.0, -1.0]),
    q_nb=quat_from_euler(0.2, -0.1, 1.0),
    omega_b_rps=np.array([0.1, -0.2, 0.3]),
    specific_force_b_mps2=np.array([0.5, 0.2, -9.7]),
    v_air_b_mps=np.array([24.0, 1.0, 2.0]),
    wind_ned_mps=np.zeros(3),
    pressure_pa=95000.0,
    temperature_k=285.0,
    density_kgpm3=1.16,
    battery_v=11.1,
    battery_a=20.0,
    battery_remaining=0.8,
)


def read(sensor: Any, truth: Truth = TRUTH) -> Any:
    """One reading of a fresh sensor."""
    rng = np.random.default_rng(0)
    return sensor.sample(truth, sensor.new_state(rng), rng)[0]


def many(sensor: Any, count: int, seed: int = 1) -> list[Any]:
    """Readings of a truth at rest."""
    rng = np.random.default_rng(seed)
    state = sensor.new_state(rng)
    out = []
    for _ in range(count):
        reading, state = sensor.sample(TRUTH, state, rng)
        out.append(reading)
    return out


def flight_at(truth: Truth) -> np.ndarray:
    """The flight's record at a truth."""
    flight = np.zeros(1, dtype=FLIGHT)
    flight["t_us"], flight["x"][0, 10:13] = truth.t_us, truth.omega_b_rps
    flight["load"][0, :3] = truth.specific_force_b_mps2
    air = truth.pressure_pa, truth.temperature_k, truth.density_kgpm3
    flight["here"][0, 3:16] = *air, *truth.v_ned_mps, *truth.q_nb, *truth.v_air_b_mps
    return flight


def measured(sensor: CompiledSensor, truth: Truth = TRUTH, count: int = 1) -> np.ndarray:
    """Values (count, 6) of a compiled sensor at a truth at rest."""
    flight, records, found = flight_at(truth), np.zeros(1, dtype=SENSOR), []
    fitted = CompiledOnboardSensor("imu0", sensor, 1, records[0])
    for _ in range(count):
        fitted.refill()
        records["due_us"] = 0.0
        measure(flight, records)
        found.append(records["values"][0].copy())
    return np.array(found)


def test_a_perfect_imu_reads_the_truth() -> None:
    (values,) = measured(ImuSensor())
    assert np.array_equal(values[3:], TRUTH.omega_b_rps)
    assert np.array_equal(values[:3], TRUTH.specific_force_b_mps2)


def test_a_perfect_magnetometer_reads_the_field_in_body_axes() -> None:
    (values,) = measured(Magnetometer(field_ned_gauss=FIELD))
    assert np.allclose(matrix_from_quat(TRUTH.q_nb) @ values[:3], FIELD)


def test_a_perfect_barometer_reads_the_pressure() -> None:
    (values,) = measured(Barometer())
    assert values[0] == TRUTH.pressure_pa
    assert values[1] == pytest.approx(pressure_altitude(95000.0))
    assert values[2] == pytest.approx(11.85)


def test_a_barometer_drifts_with_the_temperature() -> None:
    (values,) = measured(Barometer(drift_pa_per_k=2.0))
    assert values[0] == pytest.approx(95000.0 + 2.0 * (285.0 - 288.15))


def test_a_perfect_pitot_tube_reads_the_dynamic_pressure() -> None:
    (values,) = measured(Airspeed())
    assert values[0] == pytest.approx(0.5 * 1.16 * (24.0**2 + 1.0 + 4.0))


def test_a_perfect_gps_reads_position_and_velocity() -> None:
    reading = read(Gps())
    assert isinstance(reading, GpsReading)
    assert np.radians([reading.lat_deg, reading.lon_deg]) == pytest.approx([0.8, 0.15], abs=1e-14)
    assert reading.alt_m == 520.0
    assert np.array_equal(reading.v_ned_mps, TRUTH.v_ned_mps)


def test_a_perfect_range_finder_reads_the_slant_range() -> None:
    reading = read(Rangefinder())
    assert isinstance(reading, RangeReading)
    assert reading.distance_m == pytest.approx(20.0 / (np.cos(0.2) * np.cos(0.1)))


@pytest.mark.parametrize(("height", "expected"), [(500.0, 40.0), (0.0, 0.1)])
def test_a_range_finder_stops_at_its_limits(height: float, expected: float) -> None:
    assert read(Rangefinder(), replace(TRUTH, height_agl_m=height)).distance_m == expected


def test_a_range_finder_pointing_at_the_sky_measures_nothing() -> None:
    upside_down = replace(TRUTH, q_nb=quat_from_euler(np.pi, 0.0, 0.0))
    assert read(Rangefinder(), upside_down).distance_m == 40.0


def test_perfect_flow_is_rotation_and_speed_over_distance() -> None:
    level = replace(TRUTH, q_nb=np.array([1.0, 0.0, 0.0, 0.0]))
    reading = read(OpticalFlow(rate_hz=20.0), level)
    assert isinstance(reading, FlowReading)
    expected = np.array([0.1 - 5.0 / 20.0, -0.2 + 20.0 / 20.0]) * 0.05
    assert np.allclose(reading.flow_xy_rad, expected)
    assert np.allclose(reading.gyro_xyz_rad, TRUTH.omega_b_rps * 0.05)
    assert reading.quality == 255


def test_flow_beyond_its_range_has_no_quality() -> None:
    assert read(OpticalFlow(), replace(TRUTH, height_agl_m=100.0)).quality == 0


def test_perfect_vision_reads_the_pose() -> None:
    reading = read(Vision())
    assert isinstance(reading, VisionReading)
    assert np.array_equal(reading.r_ned_m, TRUTH.r_ned_m)
    assert np.array_equal(reading.v_ned_mps, TRUTH.v_ned_mps)
    assert np.allclose(reading.q_nb, TRUTH.q_nb)


def test_vision_is_configured_to_one_of_two_messages() -> None:
    assert read(Vision()).odometry
    assert not read(Vision(message="VISION_POSITION_ESTIMATE")).odometry


def test_a_perfect_battery_monitor_reads_the_pack() -> None:
    reading = read(BatteryMonitor())
    assert isinstance(reading, BatteryReading)
    assert (reading.voltage_v, reading.current_a, reading.remaining) == (11.1, 20.0, 0.8)


def test_an_imu_saturates_at_its_range() -> None:
    fast = replace(TRUTH, omega_b_rps=np.array([50.0, -50.0, 0.0]))
    (values,) = measured(ImuSensor(gyro_range_rps=5.0), fast)
    assert np.array_equal(values[3:], [5.0, -5.0, 0.0])


def test_scale_and_bias_act_on_their_axis() -> None:
    (values,) = measured(ImuSensor(gyro=NoiseModel(scale=0.1, bias=[0.0, 0.5, 0.0])))
    assert np.allclose(values[3:], 1.1 * TRUTH.omega_b_rps + [0.0, 0.5, 0.0])


def test_white_noise_has_the_configured_deviation() -> None:
    sensor = ImuSensor(gyro=NoiseModel(sigma=0.2))
    errors = measured(sensor, count=4000)[:, 3:] - TRUTH.omega_b_rps
    # 12,000 samples: the relative deviation of a standard deviation is 1/sqrt(2 n) = 0.65 %.
    assert errors.std() == pytest.approx(0.2, rel=0.03)
    assert np.abs(errors.mean(axis=0)).max() < 4.0 * 0.2 / np.sqrt(4000)


def allan_deviation(values: np.ndarray, rate_hz: float, tau_s: float) -> float:
    """Non-overlapping Allan deviation of a column per channel, pooled."""
    span = round(tau_s * rate_hz)
    means = values[: len(values) // span * span].reshape(-1, span, values.shape[1]).mean(axis=1)
    return float(np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2)))


def errors_of(noise: NoiseModel, rate_hz: float, count: int, channels: int = 8) -> np.ndarray:
    """The first errors (count, channels) of a noise model."""
    rng = np.random.default_rng(5)
    state = noise.new_state(rng, channels, rate_hz)
    blocks = [state.block]
    while len(blocks) * len(state.block) < count:
        state = noise.refill(state, rng, rate_hz)
        blocks.append(state.block)
    return np.concatenate(blocks)[:count]


@pytest.mark.parametrize("tau_s", [0.1, 1.0, 4.0])
def test_allan_deviation_of_white_noise_falls_with_the_root_of_time(tau_s: float) -> None:
    errors = errors_of(NoiseModel(density=0.01), 50.0, 20_000)
    pairs = 8 * 400.0 / tau_s
    expected = 0.01 / np.sqrt(tau_s)
    assert allan_deviation(errors, 50.0, tau_s) == pytest.approx(expected, rel=4.0 / np.sqrt(pairs))


@pytest.mark.parametrize("tau_s", [1.0, 4.0])
def test_allan_deviation_of_a_random_walk_grows_with_the_root_of_time(tau_s: float) -> None:
    errors = errors_of(NoiseModel(walk=0.02), 50.0, 20_000)
    pairs = 8 * 400.0 / tau_s
    expected = 0.02 * np.sqrt(tau_s / 3.0)  # IEEE Std 952, annex C: rate random walk
    assert allan_deviation(errors, 50.0, tau_s) == pytest.approx(expected, rel=4.0 / np.sqrt(pairs))


def test_a_drift_is_stationary_with_its_deviation_and_time_constant() -> None:
    errors = errors_of(NoiseModel(drift_sigma=3.0, drift_time_s=0.5), 20.0, 40_000)
    # About 8 * 2000 s / (2 * 0.5 s) independent samples.
    assert errors.std() == pytest.approx(3.0, rel=4.0 / np.sqrt(2.0 * 8 * 2000.0))
    lag = np.mean(errors[10:] * errors[:-10]) / errors.var()
    assert lag == pytest.approx(np.exp(-1.0), abs=0.03)


def test_a_drift_starts_from_its_stationary_distribution() -> None:
    noise = NoiseModel(drift_sigma=2.0, drift_time_s=1e6)
    first = errors_of(noise, 1.0, 1, channels=4000)
    assert first.std() == pytest.approx(2.0, rel=0.05)


def test_the_gps_error_is_the_gauss_markov_process_of_its_model() -> None:
    readings = many(Gps(rate_hz=1.0, vertical=GpsError(kick_m=0.4, k_per_s=0.2)), 4000)
    error = np.array([r.alt_m - TRUTH.alt_msl_m for r in readings])
    kicks = error[1:] - np.exp(-0.2) * error[:-1]
    assert kicks.std() == pytest.approx(0.4, rel=0.05)
    # Stationary: 0.4 / sqrt(1 - exp(-0.4)); about 4000 * 0.2 / 2 independent samples.
    assert error.std() == pytest.approx(0.4 / np.sqrt(1.0 - np.exp(-0.4)), rel=4.0 / np.sqrt(800))


def test_a_gps_error_in_metres_is_metres_on_the_ground() -> None:
    reading = read(Gps(horizontal=GpsError(kick_m=10.0, k_per_s=0.1)))
    north = (np.radians(reading.lat_deg) - 0.8) * 6.37e6
    assert 0.1 < abs(north) < 200.0


@pytest.mark.parametrize("name", ["sigma", "density", "bias_sigma", "drift_sigma", "walk"])
def test_negative_noise_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name} = -1.0 is out of range; 0 or more"):
        decode(Document({name: -1.0}, "noise.yaml", {}), NoiseModel)
