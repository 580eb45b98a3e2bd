"""Results of the analysis: one schema for Zenoh, `results.jsonl` and the reports.

JSON by msgspec with the struct's name under `type`; null means a number that is not finite. Results
hold no reference cycles, so the garbage collector ignores them (`gc=False`).
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

FOREVER_US = 1 << 62  # later than any stamp, without overflow in sums
OR_SEPARATOR = "-or-"  # joins hypotheses that a detector cannot distinguish


class Stamped(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """A result at one instant of the vehicle's clock, which labels, samples and faults share.

    To display a time, subtract `t0_us` of the labels or the first timestamp.
    """

    t_us: int

    @property
    def t_s(self) -> float:
        """Seconds on the vehicle's clock."""
        return self.t_us * 1e-6


class Decision(Stamped, frozen=True, kw_only=True, tag_field="type", tag=True, gc=False):
    """The verdict of the detector on one GNSS epoch.

    `hypothesis` is one of none, satellites, imu, clock, gps (the receiver's position, without raw
    ranges), GPS-or-imu (not distinguishable; the position then has no sigma), ephemeris (the one
    that the `reason` names is wrong, its satellite is not), multiple-unknown, or untestable (for
    the `reason`). `excluded` are the satellites left out of the solution of this epoch, `unused`
    those without a usable ephemeris, and why. `residual_m`, `normalised` and `satellites` are
    parallel. The covariance of the position is xx, xy, xz, yy, yz, zz in ECEF. `mode` names the
    prediction: inertial, free (no healthy IMU), start (first snapshot), position or position-free
    (no raw ranges). The parity test uses the satellites alone; the slow test accumulates residuals
    to detect ramps. `hpl_m` and `vpl_m` are the protection levels, valid under `level_assumes`:
    they do not bound coordinated spoofing of all satellites, with or without an IMU, before it is
    detected. Elevation, azimuth, C/N0 and signals, parallel to `satellites`, and the dilution of
    precision of the satellites in use come with a RINEX recording only, and where precise orbits
    were given `orbit_difference_m`, how far broadcast ephemerides are from these in range.
    `wrong_ephemerides` says what was found of them, beside any hypothesis.
    """

    statistic: float | None = None
    threshold: float | None = None
    dof: int = 0
    p_value: float | None = None
    alarm: bool = False
    hypothesis: str
    excluded: tuple[str, ...] = ()
    unused: dict[str, str] = {}
    reason: str = ""
    satellites: tuple[str, ...] = ()
    residual_m: tuple[float | None, ...] = ()
    normalised: tuple[float | None, ...] = ()  # residuals over their sigmas
    onset_us: int | None = None
    probabilities: dict[str, float] = {}
    position_ecef_m: tuple[float, float, float] | None = None
    position_sigma_m: tuple[float, float, float] | None = None
    position_covariance_m2: tuple[float, float, float, float, float, float] | None = None
    mode: str = ""
    parity_statistic: float | None = None
    parity_threshold: float | None = None
    parity_dof: int = 0
    slow_statistic: float | None = None
    slow_threshold: float | None = None
    elevation_deg: tuple[float, ...] = ()
    azimuth_deg: tuple[float, ...] = ()
    cn0_dbhz: tuple[float | None, ...] = ()
    signals: tuple[str, ...] = ()
    orbit_difference_m: dict[str, float] | msgspec.UnsetType = msgspec.UNSET
    wrong_ephemerides: tuple[str, ...] | msgspec.UnsetType = msgspec.UNSET
    hdop: float | None = None
    vdop: float | None = None
    hpl_m: float | None = None
    vpl_m: float | None = None
    level_assumes: str = ""


class SensorDecision(Stamped, frozen=True, kw_only=True, tag_field="type", tag=True, gc=False):
    """The verdict on another sensor, tested against the inertial reference, or on the actuators.

    `sensor` is one of baro, airspeed, mag, vision, range, gps-position, gps-velocity, imu,
    actuators. `suspect` is the faulty part, if it is not the sensor itself.
    """

    sensor: str
    statistic: float | None = None
    threshold: float | None = None
    dof: int = 0
    alarm: bool = False
    isolated: bool = False  # excluded from the solution; outlasts the alarm
    reason: str = ""
    suspect: str = ""


def pattern_alarm(
    t_us: int, sensor: str, reason: str, *, suspect: str = "", isolated: bool = True, dof: int = 0
) -> SensorDecision:
    """Build an alarm raised by a pattern in the data, without a statistic or threshold."""
    return SensorDecision(
        t_us=t_us,
        sensor=sensor,
        dof=dof,
        alarm=True,
        isolated=isolated,
        reason=reason,
        suspect=suspect,
    )


class AttitudeError(Stamped, frozen=True, kw_only=True, tag_field="type", tag=True, gc=False):
    """Estimate minus truth [deg], wrapped; `angle` is the angle of the rotation between them."""

    estimator: str
    roll: float
    pitch: float
    yaw: float
    angle: float


class FusedState(Stamped, frozen=True, kw_only=True, tag_field="type", tag=True, gc=False):
    """The fused navigation solution of one epoch with one-sigma values and the factors in use.

    `name` is "fused", or names the comparison solution computed without fault isolation.
    """

    position_ecef_m: tuple[float, float, float]
    velocity_ned_mps: tuple[float, float, float]
    q_nb: tuple[float, float, float, float]
    position_sigma_m: tuple[float, float, float]
    velocity_sigma_mps: tuple[float, float, float]
    attitude_sigma_deg: tuple[float, float, float]
    weights: dict[str, float] = {}  # 0 to 1, by source
    reason: str = ""
    name: str = "fused"


# Each has its name under `type`, so one decoder reads a file of all kinds.
Result = Decision | SensorDecision | AttitudeError | FusedState


# Created once: msgspec compiles the schema when it creates an encoder.
_ENCODER = msgspec.json.Encoder()
_DECODER: msgspec.json.Decoder[Result] = msgspec.json.Decoder(Result)


def encode(result: Result) -> bytes:
    """Encode one result as JSON."""
    return _ENCODER.encode(result)


def encode_lines(results: Iterable[Result]) -> bytes:
    """Encode results as JSON lines."""
    return _ENCODER.encode_lines(results)


def decode(line: bytes) -> Result:
    """Decode the result in a line of JSON.

    Raises
    ------
    msgspec.DecodeError
        If the line is not a result.
    """
    return _DECODER.decode(line)


def read_results(path: Path) -> Iterator[Result]:
    """Yield the results of a file in order; an incomplete last line is skipped."""
    with path.open("rb") as file:
        for line in file:
            # A killed run may leave an incomplete last line.
            if line.endswith(b"\n"):
                yield decode(line)
