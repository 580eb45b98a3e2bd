"""Parameters of the detector."""

import math
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from analysis.detection.isolation.chi_square import chi_square_threshold
from analysis.detection.isolation.hypotheses import ISOLATION_RULES
from analysis.orbits.broadcast import SYSTEMS, TYPICAL_ALPHA, TYPICAL_BETA
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

MOST_SATELLITES = 64  # satellites whose thresholds are kept in a table

Probability = Annotated[float, Meta(gt=0, lt=0.5)]
NotNegative = Annotated[float, Meta(ge=0)]
Seconds = Annotated[float, Meta(ge=0, le=1e6)]
Axes = tuple[float, float, float]
Klobuchar = tuple[float, float, float, float, float, float, float, float]


class SigmaNumbers(NamedTuple):
    """Of `SigmaModel` what does not change with time."""

    scale: float
    floor_m: float
    zenith_m: float
    thermal_m: float
    rate_mps: float


class RampNumbers(NamedTuple):
    """What the ramp tests know of a healthy satellite and a sound IMU.

    An unknown offset's variance over that of the range and its correlation time, the variance of a
    natural slope (m/s)^2, and that of what a sound IMU's acceleration may be wrong by (m/s^2)^2.
    """

    offset_share: float
    offset_s: float
    slope: float
    acceleration: float


class SigmaModel(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """One sigma of a pseudorange from elevation and C/N0.

    sigma^2 = scale^2 (floor^2 + (zenith / sin(elevation))^2 + thermal^2 10^((45 - C/N0) / 10))

    What stays the same for minutes (multipath, ephemeris and atmosphere left over) the tests with
    memory may not take for a fault: an offset of `slow` times sigma that is another one after
    `slow_s`, and a slope of `slow_mps`. `rate_mps` is one sigma of a Doppler rate in the zenith.
    """

    scale: Annotated[float, Meta(gt=0)] = 1.0
    floor_m: Annotated[float, Meta(gt=0)] = 0.3
    zenith_m: NotNegative = 0.4
    thermal_m: NotNegative = 0.3
    slow: NotNegative = 1.0
    slow_s: Annotated[float, Meta(gt=0)] = 300.0
    slow_mps: NotNegative = 0.02
    rate_mps: Annotated[float, Meta(gt=0)] = 0.15

    def sigma_m(self, elevation_rad: Vector, cn0_dbhz: Vector) -> Vector:
        """One sigma (n,) of each pseudorange; 45 dBHz where C/N0 is not given."""
        result: Vector = np.sqrt(range_variance(elevation_rad, cn0_dbhz, self.numbers))
        return result

    @cached_property
    def numbers(self) -> SigmaNumbers:
        """What of it the kernels need."""
        values = (self.scale, self.floor_m, self.zenith_m, self.thermal_m, self.rate_mps)
        return SigmaNumbers(*map(float, values))


@compiled
def range_variance(elevation_rad: Vector, cn0_dbhz: Vector, sigma: SigmaNumbers) -> Vector:
    """Variance (n,) of pseudoranges in m^2."""
    out = np.empty(elevation_rad.shape[0])
    for i in range(out.shape[0]):
        cn0 = max(cn0_dbhz[i], 0.0) if np.isfinite(cn0_dbhz[i]) else 45.0  # below is no signal
        sine = math.sin(max(elevation_rad[i], 0.05))
        thermal = sigma.thermal_m**2 * 10.0 ** ((45.0 - cn0) / 10.0)
        out[i] = sigma.scale**2 * (sigma.floor_m**2 + (sigma.zenith_m / sine) ** 2 + thermal)
    return out


class NoiseDensities(NamedTuple):
    """Squares of the densities of `ProcessNoise`."""

    gyro_rps: float
    accel_mps2: float
    gyro_walk: float
    accel_walk: float
    clock_m: float
    drift_mps: float
    isb_m: float
    motion_mps2: float


class ProcessNoise(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """Process noise: densities of the IMU, the receiver's clock, and motion without an IMU.

    The densities of the IMU are those of a small MEMS part with room for vibration and timing.
    """

    gyro_rps: NotNegative = 2e-3  # rad/s/sqrt(Hz)
    accel_mps2: NotNegative = 2e-2  # m/s^2/sqrt(Hz)
    gyro_walk: NotNegative = 2e-5  # rad/s^2/sqrt(Hz)
    accel_walk: NotNegative = 5e-4  # m/s^3/sqrt(Hz)
    clock_m: NotNegative = 0.3  # m/sqrt(s)
    drift_mps: NotNegative = 0.3  # m/s/sqrt(s)
    isb_m: NotNegative = 0.005  # m/sqrt(s)
    motion_mps2: NotNegative = 3.0  # m/s^2/sqrt(Hz), where no IMU tells of the motion

    @cached_property
    def densities(self) -> NoiseDensities:
        """Their squares, as the kernels need them."""
        return NoiseDensities(*(float(getattr(self, name)) ** 2 for name in NoiseDensities._fields))


class DetectorConfig(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """What the detector may assume and how often it may cry wolf.

    `p_false_alarm` is per GNSS epoch for the main test F00; `p_slow` per epoch for the tests with
    memory and `p_other` for Doppler and the other sensors. `rule` is how a verdict is found and
    `left_out` the most satellites left out for it. `systems` are the first letters of those that
    are used: GPS, Galileo, GLONASS (R), BeiDou (C), QZSS (J). `antenna_b_m` is where the
    antenna is from the IMU, in body axes. `readmit_s` is how long an excluded satellite
    must look healthy before it is used again, `imu_hold_s` how long a faulty IMU is not, `gap_s`
    the longest IMU gap that is bridged, `reset_s` the longest gap of epochs. `slow_accel_mps2` is
    what a sound IMU's acceleration may be wrong by for seconds. `history_s` is how far back the
    filter can be repaired. `ionosphere` holds Klobuchar's coefficients until some are received.
    """

    p_false_alarm: Probability = 1e-4
    p_slow: Probability = 1e-4
    p_other: Probability = 1e-5
    rule: str = "explicit"
    left_out: Annotated[int, Meta(ge=0, le=MOST_SATELLITES)] = 3
    systems: str = "GE"
    antenna_b_m: Axes = (0.0, 0.0, 0.0)
    mask_deg: Annotated[float, Meta(ge=0, lt=90)] = 10.0
    readmit_s: Seconds = 10.0
    imu_hold_s: Seconds = 10.0
    gap_s: Seconds = 0.15
    reset_s: Seconds = 10.0
    history_s: Seconds = 30.0
    slow_accel_mps2: NotNegative = 0.1
    doppler: bool = True
    sigma: SigmaModel = SigmaModel()
    noise: ProcessNoise = ProcessNoise()
    ionosphere: Klobuchar = (*TYPICAL_ALPHA, *TYPICAL_BETA)

    def __post_init__(self) -> None:
        """Refuse names that there are not.

        Raises
        ------
        ValueError
            Naming the field, its value and what is allowed.
        """
        if self.rule not in ISOLATION_RULES:
            raise ValueError(
                f"rule = {self.rule!r} is unknown; known: {', '.join(sorted(ISOLATION_RULES))}"
            )
        if not self.systems or not set(self.systems) <= set(SYSTEMS):
            raise ValueError(
                f"systems = {self.systems!r} names no or other systems; letters of {SYSTEMS} are"
                " known"
            )

    @cached_property
    def mask_rad(self) -> float:
        """The lowest elevation used."""
        return math.radians(self.mask_deg)

    @cached_property
    def antenna(self) -> Vector | None:
        """The antenna's lever arm (3,); None where it is at the IMU."""
        return np.array(self.antenna_b_m) if any(self.antenna_b_m) else None

    @cached_property
    def thresholds(self) -> Vector:
        """Thresholds (2, 65) of the main test and of the rates' by degrees of freedom."""
        levels = (self.p_false_alarm, self.p_other)
        return np.array(
            [[chi_square_threshold(dof, p) for dof in range(MOST_SATELLITES + 1)] for p in levels]
        )

    @cached_property
    def ramp_numbers(self) -> RampNumbers:
        """What the ramp tests' kernels need."""
        sigma = self.sigma
        slope, acceleration = sigma.slow_mps**2, self.slow_accel_mps2**2
        return RampNumbers(*map(float, (sigma.slow**2, sigma.slow_s, slope, acceleration)))

    @cached_property
    def limits(self) -> tuple[Any, ...]:
        """What a quiet epoch is judged by, as plain tuples, thresholds and numbers."""
        return (
            tuple(self.sigma.numbers),
            tuple(self.noise.densities),
            tuple(self.ramp_numbers),
            self.thresholds,
            self.mask_rad,
            float(self.gap_s),
            self.doppler,
        )
