"""A velocity that all Doppler rates show off the IMU's: three parameters, so it is seen early.

The rates' main test has as many degrees of freedom as satellites, and a receiver that is led off at
0.5 m/s is within them. With N and b of the rates' normal equations and P_c the covariance of
velocity and drift, the shift that they share and its statistic are

    u = [inv(N) b]_v,   u' inv([inv(N) + P_c]_vv) u,   chi-square(3) without a fault,

the drift unknown. Most receivers are far better than the noise that is assumed of them, so it is
held against the flight's own level. That only begins a question, asked at the epochs behind it too:
whether all satellites are led away (`imu_or_satellites`).
"""

from typing import NamedTuple

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.information import Normal, block, quadratic
from analysis.detection.isolation.chi_square import chi_square
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import apply, inverse

DOF = 3
ASKED_US = 3_000_000  # for how long the question stands
SETTLED_US = 10_000_000  # behind what failed a test: what follows may come of it
LEAST_LEVEL = 0.1
MOST_SQUARE = 9.0  # one outlier says little of the level
FIRST_WEIGHT, MOST_WEIGHT = 10.0, 150.0  # epochs of the level: at first in favour of 1


class Watched(NamedTuple):
    """The level of innovations, a mean square over `weight` epochs that passed their tests; until
    when it is asked whether all satellites lead away, and from when on it may be."""

    level: float = 1.0
    weight: float = FIRST_WEIGHT
    asked_until_us: int = 0
    settled_us: int = 0


@compiled
def common_shift(p: Vector, rates: Normal) -> float:
    """The statistic of the velocity that all rates share, before the covariance p (20, 20)."""
    cofactor = inverse(rates.information)
    off = apply(cofactor, rates.b)
    total = cofactor + block(p, rates.states)
    return quadratic(off[:DOF].copy(), inverse(np.ascontiguousarray(total[:DOF, :DOF])))


def stands_out(watched: Watched, shift: float, t_us: int, config: DetectorConfig) -> bool:
    """Whether the statistic `shift` of an epoch is more than this flight's noise."""
    limit = max(watched.level, LEAST_LEVEL) * chi_square(DOF, config.p_other)
    return t_us >= watched.settled_us and shift > limit


def asked(watched: Watched, shift: float, t_us: int, config: DetectorConfig) -> bool:
    """Whether it is to be asked who is wrong, by this epoch's shift or an earlier one."""
    return t_us < watched.asked_until_us or stands_out(watched, shift, t_us, config)


def after(watched: Watched, shift: float, t_us: int, config: DetectorConfig) -> Watched:
    """Behind an epoch whose tests passed."""
    if stands_out(watched, shift, t_us, config):
        return watched._replace(asked_until_us=t_us + ASKED_US)
    if t_us < watched.asked_until_us:
        return watched  # what is in question must not excuse itself
    weight = min(watched.weight + 1.0, MOST_WEIGHT)
    news = min(shift / DOF, MOST_SQUARE)
    return watched._replace(level=watched.level + (news - watched.level) / weight, weight=weight)


def unsettled(watched: Watched, t_us: int) -> Watched:
    """Behind an epoch that failed a test, or where the IMU does not move the filter."""
    return watched._replace(asked_until_us=0, settled_us=t_us + SETTLED_US)
