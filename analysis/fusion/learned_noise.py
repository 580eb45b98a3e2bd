"""Noise estimated in flight, so that sigmas fit the actual sensors.

A detector assumes a worst case; a covariance must be right. From fault-free epochs only: the noise
of IMU and Doppler, and the lasting share of range errors (docs/fusion.md).
"""

import math
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace

from analysis.detection.filter.filter_config import ProcessNoise
from analysis.samples.sample import Vector

# Time constants: long against an epoch, short against a flight.
IMU_S, RATE_S, SLOW_S = 5.0, 20.0, 10.0
PRIOR_S = 0.3  # age of the configured rate noise, up to five times too large: benchmarks/fusion.py
MIN_SAMPLES = 11  # 9 second differences
GYRO_FLOOR_RPS, ACCEL_FLOOR_MPS2 = 1.0e-4, 2.0e-3  # per root hertz: benchmarks/fusion.py
NOISE_RISE = 2.0  # times the variance: a step to be followed at once, not averaged
VARIANCE_RATIO_LIMITS = (0.01, 25.0)  # learned over configured: 0.1 to 5 times the sigma
MAX_SQUARE = 25.0  # limit of a squared normalised residual: 5 sigma
SLOW_PRIOR = 4.0  # the configured share counts as so many satellites
AGE, RATE, SLOW = 0, 1, 2


@dataclass(slots=True)
class LearnedNoise:
    """State, changed in place: `imu` (3,), variances per hertz of the white noise of gyros and
    accelerometers and their age in s; `table` (n, 3) by satellite: age, mean square of the rate
    residual, mean of the range residual."""

    imu: Vector = field(default_factory=lambda: np.zeros(3))
    satellites: tuple[str, ...] = ()
    table: Vector = field(default_factory=lambda: np.empty((0, 3)))
    t_us: int = 0

    def add_imu(self, samples: Vector) -> None:
        """Add samples (k, 7) of a trusted IMU: step in s, rates, specific force."""
        count = len(samples) - 1  # the last step repeats its sample
        # Few second differences give no useful variance.
        if count < MIN_SAMPLES:
            return
        total_s, inner_s = samples[:, 0].sum(), samples[:count, 0].sum()
        squares = np.diff(samples[:count, 1:], 2, axis=0) ** 2
        # Six times the variance of white noise, over three axes.
        variances = squares.mean(axis=0).reshape(2, 3).mean(axis=1) / 6.0 * inner_s / count
        for i, variance in enumerate(variances):
            # noise may rise at once
            rises = variance > NOISE_RISE * self.imu[i]
            share = 1.0 if rises else total_s / (self.imu[2] + total_s)
            self.imu[i] += (variance - self.imu[i]) * share
        self.imu[2] = min(self.imu[2] + total_s, IMU_S)

    def current_noise(self, configured: ProcessNoise) -> ProcessNoise:
        """The configured noise with the learned noise of the IMU."""
        gyro2, accel2, age_s = self.imu.tolist()
        if age_s == 0.0:
            return configured
        gyro = math.sqrt(gyro2 + GYRO_FLOOR_RPS**2)
        accel = math.sqrt(accel2 + ACCEL_FLOOR_MPS2**2)
        return replace(configured, gyro_rps=gyro, accel_mps2=accel)

    def add_ranges(
        self, t_us: int, satellites: tuple[str, ...], weights: Vector, normalised: Vector
    ) -> None:
        """Add residuals (n, 2) of ranges and rates over their configured sigmas; those of weight 0
        are ignored."""
        dt_s = min(max((t_us - self.t_us) * 1e-6, 0.0), 1.0)
        self.t_us = t_us
        self.table, self.satellites = self._rows_of(satellites), satellites
        used = weights != 0.0
        (slow, rate), age = normalised.T, self.table[:, AGE].copy()
        # An outlier must not raise the sigma that detects it.
        squares = np.minimum(rate**2, MAX_SQUARE)
        for column, memory_s, newest in ((RATE, RATE_S, squares), (SLOW, SLOW_S, slow)):
            known = used & np.isfinite(newest)
            share = dt_s / (np.minimum(age, memory_s) + dt_s)
            self.table[known, column] += (share * (newest - self.table[:, column]))[known]
        self.table[used & np.isfinite(slow), AGE] += dt_s

    def scale_rates(self, satellites: tuple[str, ...], rate_sigma: Vector) -> None:
        """Multiply the configured sigmas (n,) of rates by the learned ratio, in place."""
        rate_sigma *= np.sqrt(np.clip(self._rows_of(satellites)[:, RATE], *VARIANCE_RATIO_LIMITS))

    def lasting_share(self, configured: float, unknowns: int) -> float:
        """The lasting share of the ranges' sigmas; `unknowns` of a snapshot solution."""
        means = self.table[self.table[:, AGE] > SLOW_S / 2.0, SLOW]
        count = len(means)
        if count <= unknowns:
            return configured
        # The solution removes as many degrees of freedom as it has unknowns.
        mean_square = float(means @ means) * count / (count - unknowns)
        return math.sqrt((SLOW_PRIOR * configured**2 + mean_square) / (SLOW_PRIOR + count))

    def _rows_of(self, satellites: tuple[str, ...]) -> Vector:
        """The table's rows of some satellites; new ones start as configured."""
        if satellites == self.satellites:
            return self.table
        known = dict(zip(self.satellites, self.table, strict=True))
        new = np.array([PRIOR_S, 1.0, 0.0])
        return np.array([known.get(name, new) for name in satellites]).reshape(-1, 3)
