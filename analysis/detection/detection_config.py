"""Parameters of the detector."""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from analysis.detection.isolation.chi_square import chi_square
from analysis.detection.isolation.hypotheses import RULES
from analysis.orbits.broadcast import SYSTEMS, TYPICAL_ALPHA, TYPICAL_BETA
from analysis.samples.sample import Vector
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.compile import compiled

MOST = 64  # satellites whose thresholds are kept in a table


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


@dataclass(frozen=True, kw_only=True)
class SigmaModel:
    """One sigma of a pseudorange from elevation and C/N0.

    sigma^2 = scale^2 (floor^2 + (zenith / sin(elevation))^2 + thermal^2 10^((45 - C/N0) / 10))

    What stays the same for minutes (multipath, ephemeris and atmosphere left over) the tests with
    memory may not take for a fault: an offset of `slow` times sigma that is another one after
    `slow_s`, and a slope of `slow_mps`. `rate_mps` is one sigma of a Doppler rate in the zenith.
    """

    scale: float = 1.0
    floor_m: float = 0.3
    zenith_m: float = 0.4
    thermal_m: float = 0.3
    slow: float = 1.0
    slow_s: float = 300.0
    slow_mps: float = 0.02
    rate_mps: float = 0.15

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
    """Squares of the densities of `Noise`."""

    gyro_rps: float
    accel_mps2: float
    gyro_walk: float
    accel_walk: float
    clock_m: float
    drift_mps: float
    isb_m: float
    motion_mps2: float


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Process noise: densities of the IMU, the receiver's clock, and motion without an IMU.

    The densities of the IMU are those of a small MEMS part with room for vibration and timing.
    """

    gyro_rps: float = 2e-3  # rad/s/sqrt(Hz)
    accel_mps2: float = 2e-2  # m/s^2/sqrt(Hz)
    gyro_walk: float = 2e-5  # rad/s^2/sqrt(Hz)
    accel_walk: float = 5e-4  # m/s^3/sqrt(Hz)
    clock_m: float = 0.3  # m/sqrt(s)
    drift_mps: float = 0.3  # m/s/sqrt(s)
    isb_m: float = 0.005  # m/sqrt(s)
    motion_mps2: float = 3.0  # m/s^2/sqrt(Hz), where no IMU tells of the motion

    @cached_property
    def densities(self) -> NoiseDensities:
        """Their squares, as the kernels need them."""
        return NoiseDensities(*(float(getattr(self, name)) ** 2 for name in NoiseDensities._fields))


@dataclass(frozen=True, kw_only=True)
class DetectorConfig:
    """What the detector may assume and how often it may cry wolf.

    `p_false_alarm` is per GNSS epoch for the main test F00; `p_slow` per epoch for the tests with
    memory and `p_other` for Doppler and the other sensors. `rule` is how a verdict is found and
    `left_out` the most satellites left out for it. `systems` are the first letters of those that
    are used: GPS, Galileo, GLONASS (R), BeiDou (C). `antenna_b_m` is where the
    antenna is from the IMU, in body axes. `readmit_s` is how long an excluded satellite
    must look healthy before it is used again, `imu_hold_s` how long a faulty IMU is not, `gap_s`
    the longest IMU gap that is bridged, `reset_s` the longest gap of epochs. `slow_accel_mps2` is
    what a sound IMU's acceleration may be wrong by for seconds. `history_s` is how far back the
    filter can be repaired. `ionosphere` holds Klobuchar's coefficients until some are received.
    """

    p_false_alarm: float = 1e-4
    p_slow: float = 1e-4
    p_other: float = 1e-5
    rule: str = "explicit"
    left_out: int = 3
    systems: str = "GE"
    antenna_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mask_deg: float = 10.0
    readmit_s: float = 10.0
    imu_hold_s: float = 10.0
    gap_s: float = 0.15
    reset_s: float = 10.0
    history_s: float = 30.0
    slow_accel_mps2: float = 0.1
    doppler: bool = True
    sigma: SigmaModel = field(default_factory=SigmaModel)
    noise: Noise = field(default_factory=Noise)
    ionosphere: tuple[float, ...] = TYPICAL_ALPHA + TYPICAL_BETA

    def __post_init__(self) -> None:
        """Refuse what cannot be meant.

        Raises
        ------
        ConfigError
            Naming the field, its value and what is allowed.
        """
        for name in ("p_false_alarm", "p_slow", "p_other"):
            value = getattr(self, name)
            if not 0.0 < value < 0.5:
                raise ConfigError(f"monitor.{name} = {value} is no probability; 0 to 0.5 is")
        if self.rule not in RULES:
            raise ConfigError(
                f"monitor.rule = {self.rule!r} is unknown; known: {', '.join(sorted(RULES))}"
            )
        if len(self.antenna_b_m) != 3 or not np.isfinite(self.antenna_b_m).all():
            raise ConfigError(
                f"monitor.antenna_b_m = {self.antenna_b_m} is no place;"
                " three lengths in m are: forward, right, down"
            )
        if not self.systems or not set(self.systems) <= set(SYSTEMS):
            raise ConfigError(
                f"monitor.systems = {self.systems!r} names no or other systems;"
                f" letters of {SYSTEMS} are known"
            )
        for name in ("left_out", "readmit_s", "imu_hold_s", "gap_s", "reset_s", "history_s"):
            value = getattr(self, name)
            if not value >= 0:
                raise ConfigError(f"monitor.{name} = {value} is negative; it must be 0 or more")
        if len(self.ionosphere) != 8:
            raise ConfigError("monitor.ionosphere must hold Klobuchar's four alpha and four beta")

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
        return np.array([[chi_square(dof, p) for dof in range(MOST + 1)] for p in levels])

    @cached_property
    def ramp_numbers(self) -> RampNumbers:
        """What the ramp tests' kernels need."""
        sigma = self.sigma
        slope, acceleration = sigma.slow_mps**2, self.slow_accel_mps2**2
        return RampNumbers(*map(float, (sigma.slow**2, sigma.slow_s, slope, acceleration)))

    @classmethod
    def from_mapping(cls, values: dict[str, Any]) -> "DetectorConfig":
        """A configuration from the names of a scenario or a calibration file.

        Raises
        ------
        ConfigError
            For a name or value that is not allowed.
        """
        parts: dict[str, Any] = dict(values)
        for name, kind in (("sigma", SigmaModel), ("noise", Noise)):
            if name in parts:
                parts[name] = _build(f"monitor.{name}", kind, parts[name])
        for name in ("ionosphere", "antenna_b_m"):
            if name in parts:
                parts[name] = tuple(float(x) for x in parts[name])
        built: DetectorConfig = _build("monitor", cls, parts)
        return built


def _build(where: str, kind: Any, values: dict[str, Any]) -> Any:
    known = kind.__dataclass_fields__
    for name in values:
        if name not in known:
            raise ConfigError(f"{where}.{name} is unknown; known: {', '.join(sorted(known))}")
    return kind(**values)
