"""The test of the Doppler rates: a wrong attitude or force shows seconds before the ranges do."""

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.information import (
    NO_RATES,
    NormalEquations,
    inverse_covariance,
    rate_equations,
)
from analysis.detection.filter.measurement import Innovations
from analysis.detection.isolation.constellations import SYSTEM_CLOCK, group_by_system
from analysis.detection.isolation.epoch_statistics import LEAST_RATES, EpochStatistics
from analysis.detection.isolation.hypotheses import select_hypothesis
from analysis.detection.isolation.isolation_config import IsolationConfig
from analysis.detection.isolation.range_test import largest_subset
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.values import Value


class RateVerdict(Value, frozen=True):
    """The result of the rate test: the hypothesis, the rates that may be used, and the indices of
    the satellites whose rates are wrong."""

    statistic: float | None
    threshold: float | None
    dof: int
    hypothesis: str
    usable: NormalEquations
    faulty: tuple[int, ...] = ()


def run_rate_test(
    motion: MotionEstimate,
    innovations: Innovations,
    statistics: EpochStatistics,
    config: IsolationConfig,
) -> RateVerdict:
    """Test the Doppler rates of n satellites against the predicted velocity."""
    count = statistics.rate_count
    if not config.doppler or count < LEAST_RATES:
        return RateVerdict(None, None, 0, "none", NO_RATES)
    usable = statistics.rates
    threshold = chi_square_threshold(count, config.p_other)
    if statistics.q_rate <= threshold:
        return RateVerdict(statistics.q_rate, threshold, count, "none", usable)
    known = np.flatnonzero(np.isfinite(innovations.rate_mps))
    m, velocity, drift = inverse_covariance(motion.p, usable), usable.a[:, :3], usable.a[:, 3:]
    largest, p = largest_subset(count, config.left_out), config.p_other
    systems = group_by_system(innovations.geometry[known])
    verdict = select_hypothesis(m, usable.v, velocity, drift, p, largest, config.rule, systems)
    faulty: tuple[int, ...] = ()
    if verdict.hypothesis == "satellites":
        faulty = tuple(known[list(verdict.subset)].tolist())
        rate_mps = innovations.rate_mps.copy()
        rate_mps[list(faulty)] = np.nan
        usable = rate_equations(innovations.geometry, innovations.rate_variance, rate_mps)
    # No explanation: no rate is used, the ranges decide alone.
    elif verdict.hypothesis in ("multiple-unknown", SYSTEM_CLOCK):
        usable = NO_RATES
    return RateVerdict(statistics.q_rate, threshold, count, verdict.hypothesis, usable, faulty)
