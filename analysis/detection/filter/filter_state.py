"""The parts of the detector's state: pending IMU samples, the filter, what is left out."""

from dataclasses import dataclass
from typing import NamedTuple

from analysis.detection.values import Value
from analysis.samples.block import ImuRun
from analysis.samples.sample import StateVector, Vector
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

StoredOrbit = tuple[Ephemeris | StateVector, Vector]  # an ephemeris and its packed numbers


class PendingImu(NamedTuple):
    """IMU samples not yet used, the newest run first; `depth` of them, as memory is bounded."""

    run: ImuRun
    older: "PendingImu | None"
    depth: int


@dataclass(frozen=True, slots=True)
class Alignment:
    """What the IMU and GNSS velocity tell of attitude while it is unknown.

    `q_0b` (4,) turns body to the axes at the start, `alpha` (3,) is the specific force integrated
    in those, `beta` (3,) the same from GNSS in ECEF; `cross` and `information` (3, 3) are sums of
    beta alpha' and of (beta' beta I - beta beta'), each over the pair's variance. `unseen` are the
    variances of alpha and of the turn by what happened between the samples of a slow IMU.
    """

    start_us: int
    q_0b: Vector
    alpha: Vector
    beta: Vector
    v_ecef_mps: Vector
    cross: Vector
    information: Vector
    unseen: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A satellite left out: since when, when found, since when it looks healthy again, and whether
    it was left out with its whole system, not for what it did itself."""

    onset_us: int
    found_us: int
    healthy_since_us: int | None = None
    whole_system: bool = False


class MotionEstimate(Value, frozen=True):
    """The filter: time, state x (21,) and covariance p (20, 20) of `inertial`.

    `inertial` says whether the IMU moves it, `alignment` is how far its attitude has been found.
    """

    t_us: int
    x: Vector
    p: Vector
    inertial: bool = False
    alignment: Alignment | None = None
