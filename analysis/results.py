"""What the analysis says: one schema for Zenoh, `results.jsonl` and the reports.

JSON by msgspec, the struct's name under `type`; null stands for a number that is not finite. They
hold nothing that could lead back to them, so the garbage collector need not look (`gc=False`).
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

OR_SEPARATOR = "-or-"  # joins those whom a detector cannot tell apart


class Stamped(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """What is said of one instant, by the one clock of labels, samples and faults: the vehicle's.

    Whoever shows a time subtracts the zero that suits: `t0_us` of the labels, or the first stamp.
    """

    t_us: int

    @property
    def t_s(self) -> float:
        """Seconds on the vehicle's clock."""
        return self.t_us * 1e-6


class Decision(Stamped, frozen=True, kw_only=True, tag_field="type", tag=True, gc=False):
    """The verdict of the detector on one GNSS epoch.

    `hypothesis` is one of none, satellites, imu, clock, gps (without raw ranges: the receiver's own
    position), GPS-or-imu (one of them, and then the position has no sigma), multiple-unknown,
    untestable (then `reason` says why). `excluded` are the satellites left out of the solution at
    this epoch. `residual_m`, `normalised` and `satellites` run in parallel. `mode` says what
    predicts the epoch: inertial, free (no sound IMU), start (a first snapshot), position or
    position-free (no raw ranges). The parity test asks the satellites alone; the slow test is the
    one with memory, for ramps. `hpl_m` and `vpl_m` are the protection levels, which hold
    while `level_assumes` does: satellites that are led away all together are beyond them, with an
    IMU or without, until that is found. Of a RINEX
    recording the sky is told too, parallel to `satellites`, and the dilution of precision by those
    in use.
    """

    statistic: float | None
    threshold: float | None
    dof: int
    p_value: float | None
    alarm: bool
    hypothesis: str
    excluded: tuple[str, ...] = ()
    reason: str = ""
    satellites: tuple[str, ...] = ()
    residual_m: tuple[float | None, ...] = ()
    normalised: tuple[float | None, ...] = ()  # residuals over their sigmas
    onset_us: int | None = None
    probabilities: dict[str, float] = {}
    position_ecef_m: tuple[float, float, float] | None = None
    position_sigma_m: tuple[float, float, float] | None = None
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
    hdop: float | None = None
    vdop: float | None = None
    hpl_m: float | None = None
    vpl_m: float | None = None
    level_assumes: str = ""


class SensorDecision(Stamped, frozen=True, kw_only=True, tag_field="type", tag=True, gc=False):
    """The verdict on another sensor against the inertial reference, or on the actuators.

    `sensor` is one of baro, airspeed, mag, vision, range, gps-position, gps-velocity, imu,
    actuators. `suspect` is who of them it is, where that is not the sensor itself.
    """

    sensor: str
    statistic: float | None
    threshold: float | None
    dof: int
    alarm: bool
    isolated: bool = False  # not used any more, which outlasts the alarm
    reason: str = ""
    suspect: str = ""


def pattern_alarm(
    t_us: int, sensor: str, reason: str, *, suspect: str = "", isolated: bool = True, dof: int = 0
) -> SensorDecision:
    """An alarm by a pattern in the data, where no statistic is held against a threshold."""
    return SensorDecision(
        t_us=t_us,
        sensor=sensor,
        statistic=None,
        threshold=None,
        dof=dof,
        alarm=True,
        isolated=isolated,
        reason=reason,
        suspect=suspect,
    )


class AttitudeError(Stamped, frozen=True, kw_only=True, tag_field="type", tag=True, gc=False):
    """Estimate minus truth at one instant, in degrees, wrapped; `angle` is the rotation between."""

    estimator: str
    roll: float
    pitch: float
    yaw: float
    angle: float


class FusedState(Stamped, frozen=True, kw_only=True, tag_field="type", tag=True, gc=False):
    """The fused navigation solution of one epoch with one-sigma values and the factors in use.

    `name` tells the solution ("fused") from the one without isolation computed beside it.
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


# Each carries its name under `type`: one decoder reads a file in which all of them stand.
Result = Decision | SensorDecision | AttitudeError | FusedState


# Made once: msgspec builds the code of a schema when an encoder is made.
_ENCODER = msgspec.json.Encoder()
_DECODER: msgspec.json.Decoder[Result] = msgspec.json.Decoder(Result)


def encode(result: Result) -> bytes:
    """One result as JSON."""
    return _ENCODER.encode(result)


def encode_lines(results: Iterable[Result]) -> bytes:
    """Results as JSON, each with the end of its line."""
    return _ENCODER.encode_lines(results)


def decode(line: bytes) -> Result:
    """The result a line of JSON holds.

    Raises
    ------
    msgspec.DecodeError
        If the line is not a result.
    """
    return _DECODER.decode(line)


def read_results(path: Path) -> Iterator[Result]:
    """Results of a file in order; a last line that was cut short is left out."""
    with path.open("rb") as file:
        for line in file:
            # A run that was killed may have cut the last line.
            if line.endswith(b"\n"):
                yield decode(line)
