"""State of the filter between epochs: motion, attitude search, the IMU in use."""

from dataclasses import dataclass

from analysis.detection.values import Value
from analysis.samples.sample import Vector


@dataclass(frozen=True, slots=True)
class Alignment:
    """What IMU and GNSS velocity have shown of the attitude while it is unknown.

    `q_0b` (4,) rotates body axes to those at the start, `alpha` (3,) is the specific force
    integrated in the latter, `beta` (3,) the same from GNSS in ECEF; `cross` and `information`
    (3, 3) are sums of beta alpha' and of (beta' beta I - beta beta'), each over its variance.
    `unsampled` are the variances of alpha and of the rotation by what happened between the samples
    of a slow IMU.
    """

    start_us: int
    q_0b: Vector
    alpha: Vector
    beta: Vector
    v_ecef_mps: Vector
    cross: Vector
    information: Vector
    unsampled: tuple[float, float] = (0.0, 0.0)


class MotionEstimate(Value, frozen=True):
    """The filter: time, state x (21,) and covariance p (20, 20) of `inertial`.

    `inertial` says whether the IMU propagates it, `alignment` is the search for its attitude.
    """

    t_us: int
    x: Vector
    p: Vector
    inertial: bool = False
    alignment: Alignment | None = None


class ImuStatus(Value, frozen=True):
    """The IMU in use: its number, and the usual time between two of its samples (0: unknown).

    It is not used until `suspended_until_us` where it was isolated (None: it is trusted). `mag_b`
    (3,) is the newest magnetometer sample, which can give the attitude its heading.
    """

    id: int | None = None
    interval_s: float = 0.0
    suspended_until_us: int | None = None
    mag_b: Vector | None = None
