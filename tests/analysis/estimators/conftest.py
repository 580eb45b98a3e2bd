"""A flight of which everything is known: climbing turns of a fixed wing, sensors without noise."""

from dataclasses import dataclass

import numpy as np
import pytest

from analysis.samples.sample import AirspeedSample, GpsFix, ImuSample, MagSample, Sample

RATE_HZ = 200
FIELD_NED = np.array([0.21, 0.03, 0.42])
DECLINATION_RAD = float(np.arctan2(0.03, 0.21))
SPEED_MPS = 25.0


@dataclass(frozen=True)
class Flight:
    """Samples in order of time and the true attitude (n, 4) at each IMU sample."""

    samples: list[Sample]
    q_nb: np.ndarray


def euler_at(t_s: np.ndarray) -> np.ndarray:
    """Roll, pitch, yaw (n, 3): coordinated turns that change sides every 40 s."""
    roll = np.radians(40.0) * np.sin(2 * np.pi * t_s / 40.0)
    pitch = np.radians(5.0) + np.radians(4.0) * np.sin(2 * np.pi * t_s / 17.0)
    yaw_rate = 9.80665 / SPEED_MPS * np.tan(roll)
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (yaw_rate[1:] + yaw_rate[:-1]) * np.diff(t_s))])
    return np.stack([roll, pitch, yaw], axis=1)


def rotations(euler: np.ndarray) -> np.ndarray:
    """rot_nb (n, 3, 3)."""
    (sf, st, sy), (cf, ct, cy) = np.sin(euler).T, np.cos(euler).T
    rows = [
        [ct * cy, sf * st * cy - cf * sy, cf * st * cy + sf * sy],
        [ct * sy, sf * st * sy + cf * cy, cf * st * sy - sf * cy],
        [-st, sf * ct, cf * ct],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def quaternions(euler: np.ndarray) -> np.ndarray:
    """(n, 4) of Euler angles (n, 3)."""
    (sf, st, sy), (cf, ct, cy) = np.sin(euler / 2).T, np.cos(euler / 2).T
    return np.stack(
        [
            cf * ct * cy + sf * st * sy,
            sf * ct * cy - cf * st * sy,
            cf * st * cy + sf * ct * sy,
            cf * ct * sy - sf * st * cy,
        ],
        axis=1,
    )


def fly(duration_s: float, gyro_bias_rps: np.ndarray, gps: bool = True) -> Flight:
    """IMU at 200 Hz, field at 50, airspeed at 10 and GPS at 5 Hz."""
    fine = 10
    t_s = np.arange(round(duration_s * RATE_HZ * fine)) / (RATE_HZ * fine)
    euler = euler_at(t_s)
    rot = rotations(euler)
    v_ned = SPEED_MPS * rot[:, :, 0]
    force = np.gradient(v_ned, t_s, axis=0) - np.array([0.0, 0.0, 9.80665])
    (df, dt, dy), (f, t, _) = np.gradient(euler, t_s, axis=0).T, euler.T
    omega = np.stack(
        [
            df - dy * np.sin(t),
            dt * np.cos(f) + dy * np.sin(f) * np.cos(t),
            dy * np.cos(f) * np.cos(t) - dt * np.sin(f),
        ],
        axis=1,
    )
    samples: list[Sample] = []
    steps = range(0, len(t_s), fine)
    for k, i in enumerate(steps):
        t_us = round(t_s[i] * 1e6)
        gyro = omega[max(i - fine // 2, 0)] + gyro_bias_rps  # what lies midway since the last
        accel = rot[max(i - fine // 2, 0)].T @ force[max(i - fine // 2, 0)]
        samples.append(ImuSample(t_us, gyro, accel))
        if k % 4 == 0:
            samples.append(MagSample(t_us, rot[i].T @ FIELD_NED))
        if k % 20 == 0:
            samples.append(AirspeedSample(t_us, 0.5 * 1.225 * SPEED_MPS**2))
        if gps and k % 40 == 0:
            samples.append(GpsFix(t_us, 47.0, 8.0, 500.0, v_ned[i], 3, 10, 1.0, 1.5, "HIL_GPS"))
    return Flight(samples, quaternions(euler[::fine]))


@pytest.fixture(scope="session")
def flights() -> dict[str, Flight]:
    """A minute each: without bias, with one, and with one but no GPS."""
    bias = np.array([0.02, -0.03, 0.01])
    return {
        "clean": fly(60.0, np.zeros(3)),
        "biased": fly(60.0, bias),
        "no-gps": fly(60.0, bias, gps=False),
    }
