"""Noise as the flight itself shows it, so that sigmas fit the sensors at hand.

What a detector may assume is a worst case; a covariance is to be right. From sound epochs alone:

- the IMU's white noise from second differences of its samples (their variance is six times that of
  white noise; motion hardly shows in them), and a floor for what is not white: scale, timing;
- one sigma of each satellite's Doppler from its residuals at the filter's state;
- the share of range errors that lasts: residuals averaged over some seconds keep nothing else.
"""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from analysis.fdi.config import Noise
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled

IMU_S, RATE_S, SLOW_S = 5.0, 20.0, 10.0  # time constants
PRIOR_S = 1.0  # what the configured noise counts for
LEAST_SAMPLES = 12
GYRO_FLOOR_RPS, ACCEL_FLOOR_MPS2 = 1.0e-4, 2.0e-3  # per root hertz, as simulated flights leave
WORSE = 2.0
STEP = 1.15  # densities are rounded to powers of it, so that they seldom change
LIMITS = (0.01, 25.0)  # of variances against the configured ones
OUTLIER = 25.0  # the most that a squared normalised residual counts
SLOW_PRIOR = 4.0  # satellites that the configured share counts for
AGE, RATE, SLOW = 0, 1, 2


@dataclass(slots=True)
class Learnt:
    """What moves: variances of the IMU's white noise per hertz with their age in s, and a table
    (n, 3) by satellite: age, mean square of the rate's residual, mean of the range's."""

    imu: Vector = field(default_factory=lambda: np.zeros(2))
    imu_s: float = 0.0
    satellites: tuple[str, ...] = ()
    table: Vector = field(default_factory=lambda: np.empty((0, 3)))
    t_us: int = 0

    def hear_imu(self, samples: Vector) -> None:
        """Samples (k, 7) of a sound IMU: step in s, rates, specific force."""
        if len(samples) < LEAST_SAMPLES:
            return
        found = _white(samples)
        dt_s = float(samples[:, 0].sum())
        mean = self.imu + (found - self.imu) * dt_s / (self.imu_s + dt_s)
        self.imu = np.where(found > WORSE * self.imu, found, mean)  # noise may begin at once
        self.imu_s = min(self.imu_s + dt_s, IMU_S)

    def noise(self, configured: Noise) -> Noise:
        """The noise with what was learnt of the IMU."""
        if self.imu_s == 0.0:
            return configured
        gyro2, accel2 = self.imu.tolist()
        return _noise(
            configured,
            _level(math.hypot(math.sqrt(gyro2), GYRO_FLOOR_RPS)),
            _level(math.hypot(math.sqrt(accel2), ACCEL_FLOOR_MPS2)),
        )

    def hear_ranges(self, t_us: int, satellites: tuple[str, ...], normalised: Vector) -> None:
        """Residuals (n, 2) of ranges and rates over their configured sigmas; NaN where unused."""
        dt_s = min(max((t_us - self.t_us) * 1e-6, 0.0), 1.0)
        self.t_us = t_us
        table = self.table = self._of(satellites)
        self.satellites = satellites
        _average(table, normalised, dt_s)

    def rate_factors(self, satellites: tuple[str, ...]) -> Vector:
        """What the configured sigmas (n,) of rates are multiplied by."""
        result: Vector = np.sqrt(np.clip(self._of(satellites)[:, RATE], *LIMITS))
        return result

    def slow(self, configured: float, unknowns: int) -> float:
        """The share of the ranges' sigmas that lasts; `unknowns` a snapshot solution takes away."""
        means = self.table[self.table[:, AGE] > SLOW_S / 2.0, SLOW]
        count = len(means)
        if count <= unknowns:
            return configured
        seen = float(means @ means) * count / (count - unknowns)
        return math.sqrt((SLOW_PRIOR * configured**2 + seen) / (SLOW_PRIOR + count))

    def _of(self, satellites: tuple[str, ...]) -> Vector:
        """The table's rows of some satellites, new ones as configured."""
        if satellites == self.satellites:
            return self.table
        known = dict(zip(self.satellites, self.table, strict=True))
        new = np.array([PRIOR_S, 1.0, 0.0])
        return np.array([known.get(name, new) for name in satellites]).reshape(-1, 3)


def _level(density: float) -> int:
    return round(math.log(density) / math.log(STEP))


@lru_cache(maxsize=256)
def _noise(configured: Noise, gyro: int, accel: int) -> Noise:
    return replace(configured, gyro_rps=STEP**gyro, accel_mps2=STEP**accel)


@compiled
def _white(samples: Vector) -> Vector:
    """Variances (2,) per hertz of gyros and accelerometers, from second differences."""
    count = samples.shape[0] - 1  # the last step repeats its sample
    whole_s, sums = 0.0, np.zeros(2)
    for k in range(count):
        whole_s += samples[k, 0]
        if k >= 2:
            for i in range(6):
                bend = samples[k, 1 + i] - 2.0 * samples[k - 1, 1 + i] + samples[k - 2, 1 + i]
                sums[i // 3] += bend * bend / 18.0
    sums *= whole_s / (count * (count - 2))
    return sums


@compiled
def _average(table: Vector, normalised: Vector, dt_s: float) -> None:
    """Take residuals (n, 2) into a table (n, 3), in place."""
    for i in range(table.shape[0]):
        slow, rate = normalised[i, 0], normalised[i, 1]
        age = table[i, 0]
        if np.isfinite(rate):
            share = dt_s / (min(age, RATE_S) + dt_s)
            table[i, 1] += share * (min(rate * rate, OUTLIER) - table[i, 1])
        if np.isfinite(slow):
            share = dt_s / (min(age, SLOW_S) + dt_s)
            table[i, 2] += share * (slow - table[i, 2])
            table[i, 0] = age + dt_s
