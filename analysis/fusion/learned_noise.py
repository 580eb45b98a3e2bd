"""Noise as the flight itself shows it, so that sigmas fit the sensors at hand.

What a detector may assume is a worst case; a covariance is to be right. From sound epochs alone:

- the IMU's white noise from second differences of its samples (their variance is six times that of
  white noise; motion hardly shows in them), and a floor for what is not white: scale, timing;
- one sigma of each satellite's Doppler from its residuals at the filter's state;
- the share of range errors that lasts: residuals averaged over some seconds keep nothing else.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace

from analysis.detection.filter.process_noise import ProcessNoise
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

IMU_S, RATE_S, SLOW_S = 5.0, 20.0, 10.0  # time constants
PRIOR_S = 0.3  # what the configured rate noise counts for: it may be five times too large
MIN_SAMPLES = 11
GYRO_FLOOR_RPS, ACCEL_FLOOR_MPS2 = 1.0e-4, 2.0e-3  # per root hertz, as simulated flights leave
NOISE_RISE = 2.0
CHANGE_FACTOR = (
    1.05  # densities stay as they are until they are off by it, so that they seldom change
)
VARIANCE_RATIO_LIMITS = (0.01, 25.0)  # of variances against the configured ones
MAX_SQUARE = 25.0  # the most that a squared normalised residual counts
SLOW_PRIOR = 4.0  # satellites that the configured share counts for
AGE, RATE, SLOW = 0, 1, 2


@dataclass(slots=True)
class LearnedNoise:
    """What moves, in place: variances of the IMU's white noise per hertz, of gyros and
    accelerometers, and how long it was heard in s (3,); a table (n, 3) by satellite: age, mean
    square of the rate's residual, mean of the range's; the noise `imu_noise` last."""

    imu: Vector = field(default_factory=lambda: np.zeros(3))
    satellites: tuple[str, ...] = ()
    table: Vector = field(default_factory=lambda: np.empty((0, 3)))
    t_us: int = 0
    imu_noise: ProcessNoise | None = None

    def add_imu(self, samples: Vector) -> None:
        """Samples (k, 7) of a sound IMU: step in s, rates, specific force."""
        _add_imu(self.imu, samples)

    def current_noise(self, configured: ProcessNoise) -> ProcessNoise:
        """The noise with what was learnt of the IMU."""
        gyro2, accel2, heard_s = self.imu.tolist()
        if heard_s == 0.0:
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
        """Residuals (n, 2) of ranges and rates over their configured sigmas; where the weights (n,)
        are 0 they are not used."""
        dt_s = min(max((t_us - self.t_us) * 1e-6, 0.0), 1.0)
        self.t_us = t_us
        self._start_satellites(satellites)
        _add_residuals(self.table, weights, normalised, dt_s)

    def scale_rates(self, satellites: tuple[str, ...], rate_sigma: Vector) -> None:
        """Multiply the configured sigmas (n,) of rates, in place."""
        _scale_sigmas(self._rows_of(satellites), rate_sigma)

    def lasting_share(self, configured: float, unknowns: int) -> float:
        """The share of the ranges' sigmas that lasts; `unknowns` a snapshot solution takes away."""
        means = self.table[self.table[:, AGE] > SLOW_S / 2.0, SLOW]
        count = len(means)
        if count <= unknowns:
            return configured
        # Solving takes as many degrees of freedom as it has unknowns.
        seen = float(means @ means) * count / (count - unknowns)
        return math.sqrt((SLOW_PRIOR * configured**2 + seen) / (SLOW_PRIOR + count))

    def _start_satellites(self, satellites: tuple[str, ...]) -> None:
        self.table, self.satellites = self._rows_of(satellites), satellites

    def _rows_of(self, satellites: tuple[str, ...]) -> Vector:
        """The table's rows of some satellites, new ones as configured."""
        if satellites == self.satellites:
            return self.table
        known = dict(zip(self.satellites, self.table, strict=True))
        new = np.array([PRIOR_S, 1.0, 0.0])
        return np.array([known.get(name, new) for name in satellites]).reshape(-1, 3)


@compiled
def _add_imu(imu: Vector, samples: Vector) -> None:
    """Take samples (k, 7) into the IMU's variances and age (3,), from second differences."""
    count = samples.shape[0] - 1  # the last step repeats its sample
    # Second differences of a few samples say next to nothing of a variance.
    if count < MIN_SAMPLES:
        return
    whole_s, sums = samples[count, 0], np.zeros(2)
    for k in range(count):
        whole_s += samples[k, 0]
        if k >= 2:
            for i in range(6):
                bend = samples[k, 1 + i] - 2.0 * samples[k - 1, 1 + i] + samples[k - 2, 1 + i]
                # Six times the variance of white noise, over three axes: hence 18.
                sums[i // 3] += bend * bend / 18.0
    inner_s = whole_s - samples[count, 0]
    for i in range(2):
        found = sums[i] * inner_s / (count * (count - 2))
        # noise may begin at once
        share = 1.0 if found > NOISE_RISE * imu[i] else whole_s / (imu[2] + whole_s)
        imu[i] += (found - imu[i]) * share
    imu[2] = min(imu[2] + whole_s, IMU_S)


@compiled
def _add_residuals(table: Vector, weights: Vector, normalised: Vector, dt_s: float) -> None:
    """Take residuals (n, 2) into a table (n, 3), in place."""
    for i in range(table.shape[0]):
        if weights[i] == 0.0:
            continue
        slow, rate = normalised[i, 0], normalised[i, 1]
        age = table[i, AGE]
        if np.isfinite(rate):
            share = dt_s / (min(age, RATE_S) + dt_s)
            # An outlier must not raise the sigma that would find it.
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
