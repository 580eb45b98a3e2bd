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
from analysis.detection.filter.information import NormalEquations, covariance_block, quadratic_form
from analysis.detection.isolation.chi_square import chi_square_threshold
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import invert_positive_definite, multiply_vector

SHIFT_DOF = 3
SUSPECTED_US = 3_000_000  # for how long the question stands
SETTLING_US = 10_000_000  # behind what failed a test: what follows may come of it
LEAST_LEVEL = 0.1
LARGEST_SQUARE = 9.0  # one outlier says little of the level
FIRST_WEIGHT, MOST_WEIGHT = 10.0, 150.0  # epochs of the level: at first in favour of 1


class CommonShift(NamedTuple):
    """The level of innovations, a mean square over `weight` epochs that passed their tests; until
    when it is asked whether all satellites lead away, and from when on it may be."""

    level: float = 1.0
    weight: float = FIRST_WEIGHT
    suspected_until_us: int = 0
    settled_from_us: int = 0


@compiled
def shift_statistic(p: Vector, rates: NormalEquations) -> float:
    """The statistic of the velocity that all rates share, before the covariance p (20, 20)."""
    cofactor = invert_positive_definite(rates.information)
    off = multiply_vector(cofactor, rates.b)
    total = cofactor + covariance_block(p, rates.states)
    return quadratic_form(
        off[:SHIFT_DOF].copy(),
        invert_positive_definite(np.ascontiguousarray(total[:SHIFT_DOF, :SHIFT_DOF])),
    )


def shift_stands_out(watched: CommonShift, shift: float, t_us: int, config: DetectorConfig) -> bool:
    """Whether the statistic `shift` of an epoch is more than this flight's noise."""
    limit = max(watched.level, LEAST_LEVEL) * chi_square_threshold(SHIFT_DOF, config.p_other)
    return t_us >= watched.settled_from_us and shift > limit


def shift_is_suspected(
    watched: CommonShift, shift: float, t_us: int, config: DetectorConfig
) -> bool:
    """Whether it is to be asked who is wrong, by this epoch's shift or an earlier one."""
    return t_us < watched.suspected_until_us or shift_stands_out(watched, shift, t_us, config)


def update_common_shift(
    watched: CommonShift, shift: float, t_us: int, config: DetectorConfig
) -> CommonShift:
    """Behind an epoch whose tests passed."""
    if shift_stands_out(watched, shift, t_us, config):
        return watched._replace(suspected_until_us=t_us + SUSPECTED_US)
    if t_us < watched.suspected_until_us:
        return watched  # what is in question must not excuse itself
    weight = min(watched.weight + 1.0, MOST_WEIGHT)
    news = min(shift / SHIFT_DOF, LARGEST_SQUARE)
    return watched._replace(level=watched.level + (news - watched.level) / weight, weight=weight)


def reset_common_shift(watched: CommonShift, t_us: int) -> CommonShift:
    """Behind an epoch that failed a test, or where the IMU does not move the filter."""
    return watched._replace(suspected_until_us=0, settled_from_us=t_us + SETTLING_US)
