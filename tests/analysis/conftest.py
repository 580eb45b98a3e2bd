"""A simulated flight for the detector's tests: exact kinematics, the simulator's GNSS and noise."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from analysis.fdi.inertial import gravity_ecef
from analysis.gnss import EARTH_RATE_RPS, geodetic, ned_axes
from analysis.samples import EphemerisSample, Epoch, GpsFix, ImuSample, Sample, TruthSample
from mavproxy_fault.wire.ephemeris import decode_ephemeris
from simvehicle.body import Truth
from simvehicle.earth import ecef_from_geodetic
from simvehicle.gnss.config import GnssConfig
from simvehicle.gnss.sensor import gnss_sensor
from simvehicle.readings import EphemerisReading, GpsReading, PseudorangeReading
from simvehicle.rotation import quat_from_matrix

LAT, LON, HEIGHT_M = math.radians(47.4), math.radians(8.55), 500.0
STEP_US = 5000
EPOCH_STEPS = 40


def _position(t: float, axes: np.ndarray) -> np.ndarray:
    """A figure of eight, 25 m/s, in ECEF."""
    w = 2.0 * math.pi / 40.0
    north, east, up = 150.0 * math.sin(w * t), 80.0 * math.sin(2.0 * w * t), 5.0 * math.sin(w * t)
    home = np.asarray(ecef_from_geodetic(LAT, LON, HEIGHT_M))
    return home + axes.T @ np.array([north, east, -up])


def _attitude(v: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Body axes (columns) in ECEF: forward along the velocity, the force in the body's plane."""
    forward = v / np.linalg.norm(v)
    right = np.cross(-force, forward)
    right = -right / np.linalg.norm(right) * -1.0
    return np.column_stack([forward, right, np.cross(forward, right)])


def make_flight(seconds: float, seed: int = 1, with_fix: bool = False) -> list[Sample]:
    """IMU at 200 Hz, pseudoranges at 5 Hz and the truth of a flight."""
    rng = np.random.default_rng(seed)
    axes = ned_axes(LAT, LON)
    gnss = gnss_sensor(GnssConfig(), LAT, LON)
    state = gnss.new_state(rng)
    earth = np.array([0.0, 0.0, EARTH_RATE_RPS])
    gyro_bias, accel_bias = rng.normal(0, 0.003, 3), rng.normal(0, 0.05, 3)
    dt, samples = STEP_US * 1e-6, []

    def kinematics(t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        h = 1e-2
        a, b, c = (_position(t + k * h, axes) for k in (-1, 0, 1))
        v, acc = (c - a) / (2 * h), (c - 2 * b + a) / h**2
        force = acc - gravity_ecef(b) + 2.0 * np.cross(earth, v)
        return b, v, force, _attitude(v, force)

    for k in range(int(seconds / dt) + 1):
        t = k * dt
        r, v, _, rot = kinematics(t)
        _, _, force, middle = kinematics(t - 0.5 * dt)
        before, after = kinematics(t - dt)[3], rot
        turn = before.T @ after
        rate = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        gyro = 0.5 * rate / dt + middle.T @ earth + gyro_bias + rng.normal(0, 0.01, 3)
        accel = middle.T @ force + accel_bias + rng.normal(0, 0.05, 3)
        samples.append(ImuSample(k * STEP_US, gyro, accel))
        if k % EPOCH_STEPS == 0:
            lat, lon, height = geodetic(r)
            here = ned_axes(lat, lon)
            truth = _truth(k * STEP_US, lat, lon, height, here @ v, here @ rot)
            readings, state = gnss.sample(truth, state, rng)
            for reading in readings:
                samples += _samples(reading, with_fix)
            samples.append(
                TruthSample(
                    k * STEP_US,
                    truth.q_nb,
                    gyro,
                    math.degrees(lat),
                    math.degrees(lon),
                    height,
                    here @ v,
                )
            )
    return samples


def _truth(t_us, lat, lon, height, v_ned, rot_nb) -> Truth:
    zero = np.zeros(3)
    return Truth(
        t_us=t_us,
        lat_rad=lat,
        lon_rad=lon,
        height_m=height,
        alt_msl_m=height,
        height_agl_m=height - HEIGHT_M + 100.0,
        r_ned_m=zero,
        v_ned_mps=v_ned,
        q_nb=quat_from_matrix(rot_nb),
        omega_b_rps=zero,
        specific_force_b_mps2=zero,
        v_air_b_mps=zero,
        wind_ned_mps=zero,
        pressure_pa=95_000.0,
        temperature_k=285.0,
        density_kgpm3=1.16,
        battery_v=12.0,
        battery_a=1.0,
        battery_remaining=0.9,
    )


def _samples(reading: object, with_fix: bool) -> list[Sample]:
    if isinstance(reading, EphemerisReading):
        return [EphemerisSample(reading.t_us, decode_ephemeris(reading.rtcm))]
    if isinstance(reading, PseudorangeReading):
        return [
            Epoch(
                reading.t_us,
                reading.week,
                reading.tow_s,
                reading.satellites,
                reading.pseudorange_m,
                reading.doppler_mps,
                reading.cn0_dbhz,
            )
        ]
    if isinstance(reading, GpsReading) and with_fix:
        return [
            GpsFix(
                reading.t_us,
                reading.lat_deg,
                reading.lon_deg,
                reading.alt_m,
                reading.v_ned_mps,
                reading.fix_type,
                reading.satellites,
                reading.eph_m,
                reading.epv_m,
                "HIL_GPS",
            )
        ]
    return []


@pytest.fixture(scope="session")
def flight() -> list[Sample]:
    """A minute of clean flight."""
    return make_flight(60.0)


@pytest.fixture(scope="session")
def flights() -> Callable[..., list[Sample]]:
    """`make_flight`, for other lengths and seeds."""
    return make_flight
