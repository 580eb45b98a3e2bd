"""The detector's moving part; every step hands back a new one."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from analysis.samples import ImuSample, Vector
from mavproxy_fault.wire.ephemeris import Ephemeris

Stored = tuple[Ephemeris, Vector]  # an ephemeris and its packed numbers


class Pending(NamedTuple):
    """IMU samples not yet used, newest first; `depth` of them, so that memory stays bounded."""

    sample: ImuSample
    older: "Pending | None"
    depth: int


@dataclass(frozen=True, slots=True)
class Alignment:
    """What the IMU and GNSS velocity tell of attitude while it is unknown.

    `q_0b` (4,) turns body to the axes at the start, `alpha` (3,) is the specific force integrated
    in those, `beta` (3,) the same from GNSS in ECEF; `pairs` are earlier (alpha, beta, variance).
    """

    start_us: int
    q_0b: Vector
    alpha: Vector
    beta: Vector
    v_ecef_mps: Vector
    pairs: tuple[tuple[Vector, Vector, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Exclusion:
    """A satellite left out: since when, and since when it looks healthy again."""

    onset_us: int
    healthy_since_us: int | None = None


@dataclass(frozen=True, slots=True)
class Motion:
    """The filter: time, state x (19,) and covariance p (18, 18) of `inertial`.

    `inertial` says whether the IMU moves it; `last` (6,) are the rates and force last used.
    """

    t_us: int
    x: Vector
    p: Vector
    inertial: bool = False
    last: Vector = field(default_factory=lambda: np.zeros(6))
    alignment: Alignment | None = None


@dataclass(frozen=True, slots=True)
class Core:
    """Everything but the pending IMU samples.

    `imu_bad_until_us` is when a faulty IMU is tried again (None: it is trusted), `unknown_since_us`
    since when every epoch had the verdict "multiple-unknown". `ranges_us` is when raw ranges were
    last usable; `gps_source` and `last_fix` (time and ECEF position) serve when there are none.
    """

    motion: Motion | None
    ephemerides: dict[str, tuple[Stored, ...]]
    ionosphere: Vector
    excluded: dict[str, Exclusion] = field(default_factory=dict)
    imu_id: int | None = None
    imu_bad_until_us: int | None = None
    mag_b: Vector | None = None
    unknown_since_us: int | None = None
    ranges_us: int | None = None
    gps_source: str | None = None
    last_fix: tuple[int, Vector] | None = None


class State(NamedTuple):
    """The detector's state."""

    core: Core
    pending: Pending | None = None
