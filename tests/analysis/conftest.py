"""A simulated flight for the detector's tests: exact kinematics, the simulator's GNSS and noise."""

import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from analysis.detection.filter.inertial import gravity_ecef
from analysis.samples.sample import EphemerisSample, Epoch, GpsFix, ImuSample, Sample, TruthSample
from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.numerics.rotations.rotation import quat_from_matrix
from mavproxy_fault.rtcm.ephemeris_messages import decode_ephemeris
from simvehicle.gnss.gnss_config import GnssConfig
from simvehicle.sensors.readings import EphemerisReading, GpsReading, PseudorangeReading
from simvehicle.vehicles.body import Truth
from tests.simvehicle.gnss.gnss_parts import gnss_sensor

LAT, LON, HEIGHT_M = math.radians(47.4), math.radians(8.55), 500.0
STEP_US = 5000
EPOCH_STEPS = 40
EARTH = np.array([0.0, 0.0, GNSS_EARTH_RATE_RPS])


def _path(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A figure of eight at 25 m/s: position, velocity, acceleration (n, 3) in ECEF."""
    w = 2.0 * math.pi / 40.0
    sizes, rates = np.array([150.0, 80.0, -5.0]), np.array([w, 2.0 * w, w])  # north, east, down
    angle = np.outer(t, rates)
    axes = ned_axes(LAT, LON)
    home = np.asarray(ecef_from_geodetic(LAT, LON, HEIGHT_M))
    return (
        home + (sizes * np.sin(angle)) @ axes,
        (sizes * rates * np.cos(angle)) @ axes,
        (-sizes * rates**2 * np.sin(angle)) @ axes,
    )


def _attitudes(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Body axes (n, 3, 3) as columns in ECEF, and the specific force (n, 3) in ECEF.

    The nose points along the velocity, the force lies in the plane of symmetry.
    """
    r, v, a = _path(t)
    force = a - np.array([gravity_ecef(row) for row in r]) + 2.0 * np.cross(EARTH, v)
    forward = v / np.linalg.norm(v, axis=1)[:, None]
    right = np.cross(forward, force)
    right = right / np.linalg.norm(right, axis=1)[:, None]
    down = np.cross(forward, right)
    return np.stack([forward, right, down], axis=2), force


def make_flight(
    seconds: float,
    seed: int = 1,
    with_fix: bool = False,
    epoch_steps: int = EPOCH_STEPS,
    away: Callable[[float], tuple[float, float]] = lambda t_s: (0.0, 0.0),
) -> list[Sample]:
    """IMU at 200 Hz, pseudoranges at 5 Hz, or every so many steps, and the truth of a flight.

    A spoofer of all signals leads the receiver `away`: m and m/s to the north, by the time in s.
    """
    rng = np.random.default_rng(seed)
    gnss = gnss_sensor(GnssConfig(rate_hz=1e6 / STEP_US / epoch_steps), LAT, LON)
    state = gnss.new_state(rng)
    dt = STEP_US * 1e-6
    count = round(seconds / dt) + 1
    t = np.arange(count) * dt
    (r, v, _), (rot, _), (middle, force) = _path(t), _attitudes(t), _attitudes(t - 0.5 * dt)
    turn = np.einsum("nji,njk->nik", _attitudes(t - dt)[0], rot)
    rates = np.stack(
        [
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ],
        axis=1,
    )
    gyro = 0.5 * rates / dt + middle.transpose(0, 2, 1) @ EARTH + rng.normal(0, 0.003, 3)
    gyro += rng.normal(0, 0.01, (count, 3))
    accel = np.einsum("nji,nj->ni", middle, force) + rng.normal(0, 0.05, 3)
    accel += rng.normal(0, 0.05, (count, 3))
    samples: list[Sample] = []
    for k in range(count):
        samples.append(ImuSample(k * STEP_US, gyro[k], accel[k]))
        if k % epoch_steps == 0:
            lat, lon, height = geodetic_position(r[k])
            here = ned_axes(lat, lon)
            truth = _truth(k * STEP_US, lat, lon, height, here @ v[k], here @ rot[k])
            readings, state = gnss.sample(_led(truth, *away(float(t[k]))), state, rng)
            for reading in readings:
                samples += _samples(reading, with_fix)
            place = math.degrees(lat), math.degrees(lon), height
            samples.append(TruthSample(truth.t_us, truth.q_nb, gyro[k], *place, here @ v[k]))
    return samples


def _led(truth: Truth, north_m: float, north_mps: float) -> Truth:
    """The truth as a receiver has it that a spoofer leads away."""
    if not north_m and not north_mps:
        return truth
    lat, lon, height = geodetic_position(
        ecef_from_geodetic(truth.lat_rad, truth.lon_rad, truth.height_m)
        + north_m * ned_axes(truth.lat_rad, truth.lon_rad)[0]
    )
    v_ned_mps = truth.v_ned_mps + np.array([north_mps, 0.0, 0.0])
    return msgspec.structs.replace(
        truth, lat_rad=lat, lon_rad=lon, height_m=height, v_ned_mps=v_ned_mps
    )


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
