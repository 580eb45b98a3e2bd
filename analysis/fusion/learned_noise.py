"""Noise estimated in flight, so that sigmas fit the actual sensors.

A detector assumes a worst case; a covariance must be right. From fault-free epochs only:

- the IMU's white noise from second differences of its samples (their variance is six times that of
white noise; motion hardly affects them), and a floor for errors that are not white: scale, timing;
- the sigma of each satellite's Doppler from its residuals at the filter's state;
- the lasting share of range errors from residuals averaged over some seconds.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace

from analysis.detection.filter.process_noise import ProcessNoise
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

# Time constants: long against an epoch, short against a flight.
IMU_S, RATE_S, SLOW_S = 5.0, 20.0, 10.0
PRIOR_S = 0.3  # age of the configured rate noise, up to five times too large: benchmarks/fusion.py
MIN_SAMPLES = 11  # 9 second differences
GYRO_FLOOR_RPS, ACCEL_FLOOR_MPS2 = 1.0e-4, 2.0e-3  # per root hertz: benchmarks/fusion.py
NOISE_RISE = 2.0  # times the variance: a step to be followed at once, not averaged
CHANGE_FACTOR = 1.05  # smaller changes are ignored: each new density recomputes parameters
VARIANCE_RATIO_LIMITS = (0.01, 25.0)  # learned over configured: 0.1 to 5 times the sigma
MAX_SQUARE = 25.0  # limit of a squared normalised residual: 5 sigma
SLOW_PRIOR = 4.0  # the configured share counts as so many satellites
AGE, RATE, SLOW = 0, 1, 2


@dataclass(slots=True)
class LearnedNoise:
    """State, changed in place: `imu` (3,), variances per hertz of the white noise of gyros and
    accelerometers and their age in s; `table` (n, 3) by satellite: age, mean square of the rate
    residual, mean of the range residual; the IMU noise returned last."""

    imu: Vector = field(default_factory=lambda: np.zeros(3))
    satellites: tuple[str, ...] = ()
    table: Vector = field(default_factory=lambda: np.empty((0, 3)))
    t_us: int = 0
    imu_noise: ProcessNoise | None = None

    def add_imu(self, samples: Vector) -> None:
        """Add samples (k, 7) of a trusted IMU: step in s, rates, specific force."""
        _add_imu(self.imu, samples)

    def current_noise(self, configured: ProcessNoise) -> ProcessNoise:
        """The configured noise with the learned noise of the IMU."""
        gyro2, accel2, age_s = self.imu.tolist()
        if age_s == 0.0:
            return configured
        gyro = math.sqrt(gyro2 + GYRO_FLOOR_RPS**2)
        accel = math.sqrt(accel2 + ACCEL_FLOOR_MPS2**2)
        known = self.imu_noise
        if known is None or not (
            1.0 / CHANGE_FACTOR < gyro / known.gyro_rps < CHANGE_FACTOR
            and 1.0 / CHANGE_FACTOR < accel / known.accel_mps2 < CHANGE_FACTOR
        ):
            known = self.imu_noise = replace(configured, gyro_rps=gyro, accel_mps2=accel)
        return known

    def add_ranges(
        self, t_us: int, satellites: tuple[str, ...], weights: Vector, normalised: Vector
    ) -> None:
        """Add residuals (n, 2) of ranges and rates over their configured sigmas; those of weight 0
        are ignored."""
        dt_s = min(max((t_us - self.t_us) * 1e-6, 0.0), 1.0)
        self.t_us = t_us
        self._start_satellites(satellites)
        _add_residuals(self.table, weights, normalised, dt_s)

    def scale_rates(self, satellites: tuple[str, ...], rate_sigma: Vector) -> None:
        """Multiply the configured sigmas (n,) of rates by the learned ratio, in place."""
        _scale_sigmas(self._rows_of(satellites), rate_sigma)

    def lasting_share(self, configured: float, unknowns: int) -> float:
        """The lasting share of the ranges' sigmas; `unknowns` of a snapshot solution."""
        means = self.table[self.table[:, AGE] > SLOW_S / 2.0, SLOW]
        count = len(means)
        if count <= unknowns:
            return configured
        # The solution removes as many degrees of freedom as it has unknowns.
        mean_square = float(means @ means) * count / (count - unknowns)
        return math.sqrt((SLOW_PRIOR * configured**2 + mean_square) / (SLOW_PRIOR + count))

    def _start_satellites(self, satellites: tuple[str, ...]) -> None:
        self.table, self.satellites = self._rows_of(satellites), satellites

    def _rows_of(self, satellites: tuple[str, ...]) -> Vector:
        """The table's rows of some satellites; new ones start as configured."""
        if satellites == self.satellites:
            return self.table
        known = dict(zip(self.satellites, self.table, strict=True))
        new = np.array([PRIOR_S, 1.0, 0.0])
        return np.array([known.get(name, new) for name in satellites]).reshape(-1, 3)


@compiled
def _add_imu(imu: Vector, samples: Vector) -> None:
    """Update the IMU's variances and age (3,) from second differences of samples (k, 7)."""
    count = samples.shape[0] - 1  # the last step repeats its sample
    # Few second differences give no useful variance.
    if count < MIN_SAMPLES:
        return
    total_s, sums = samples[count, 0], np.zeros(2)
    for k in range(count):
        total_s += samples[k, 0]
        if k >= 2:
            for i in range(6):
                difference = samples[k, 1 + i] - 2.0 * samples[k - 1, 1 + i] + samples[k - 2, 1 + i]
                # Six times the variance of white noise, over three axes: 18.
                sums[i // 3] += difference * difference / 18.0
    inner_s = total_s - samples[count, 0]
    for i in range(2):
        variance = sums[i] * inner_s / (count * (count - 2))
        # noise may rise at once
        share = 1.0 if variance > NOISE_RISE * imu[i] else total_s / (imu[2] + total_s)
        imu[i] += (variance - imu[i]) * share
    imu[2] = min(imu[2] + total_s, IMU_S)


@compiled
def _add_residuals(table: Vector, weights: Vector, normalised: Vector, dt_s: float) -> None:
    """Average residuals (n, 2) into a table (n, 3), in place."""
    for i in range(table.shape[0]):
        if weights[i] == 0.0:
            continue
        slow, rate = normalised[i, 0], normalised[i, 1]
        age = table[i, AGE]
        if np.isfinite(rate):
            share = dt_s / (min(age, RATE_S) + dt_s)
            # An outlier must not raise the sigma that detects it.
            table[i, RATE] += share * (min(rate * rate, MAX_SQUARE) - table[i, RATE])
        if np.isfinite(slow):
            share = dt_s / (min(age, SLOW_S) + dt_s)
            table[i, SLOW] += share * (slow - table[i, SLOW])
            table[i, AGE] = age + dt_s


@compiled
def _scale_sigmas(table: Vector, sigma: Vector) -> None:
    """Multiply configured sigmas (n,) by the root of a table's (n, 3) mean squares, in place."""
    for i in range(table.shape[0]):
        sigma[i] *= math.sqrt(
            min(max(table[i, RATE], VARIANCE_RATIO_LIMITS[0]), VARIANCE_RATIO_LIMITS[1])
        )
