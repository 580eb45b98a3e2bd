"""The test of the Doppler rates: a wrong attitude or force shows seconds before the ranges do."""

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import DRIFT, ERROR_SIZE, ISB, V
from analysis.detection.filter.information import inverse_covariance
from analysis.detection.filter.measurement import (
    NO_RATES,
    Innovations,
    RateInnovations,
)
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
    usable: RateInnovations
    faulty: tuple[int, ...] = ()


def run_rate_test(
    motion: MotionEstimate,
    innovations: Innovations,
    statistics: EpochStatistics,
    config: IsolationConfig,
) -> RateVerdict:
    """Test the Doppler rates of n satellites against the predicted velocity."""
    count = statistics.rates
    if not config.doppler or count < LEAST_RATES:
        return RateVerdict(None, None, 0, "none", NO_RATES)
    usable = RateInnovations(innovations.rate_mps, innovations.rate_variance, innovations.geometry)
    threshold = chi_square_threshold(count, config.p_other)
    if statistics.q_rate <= threshold:
        return RateVerdict(statistics.q_rate, threshold, count, "none", usable)
    known = np.flatnonzero(np.isfinite(usable.rate_mps))
    h, v = np.zeros((len(known), ERROR_SIZE)), usable.rate_mps[known]
    h[:, V : V + 3], h[:, DRIFT] = usable.geometry[known, :3], 1.0
    # Only known rates: the kernel does not accept NaN.
    m = inverse_covariance(motion.p, h, usable.variance[known])
    velocity = np.ascontiguousarray(h[:, 3:6])
    drift = np.ascontiguousarray(h[:, DRIFT : DRIFT + 1])
    largest, p = largest_subset(count, config.left_out), config.p_other
    geometry = innovations.geometry[known]
    systems = group_by_system(geometry[:, :3], geometry[:, ISB:ERROR_SIZE])
    verdict = select_hypothesis(m, v, velocity, drift, p, largest, config.rule, systems)
    faulty: tuple[int, ...] = ()
    if verdict.hypothesis == "satellites":
        faulty = tuple(known[list(verdict.subset)].tolist())
        kept = usable.rate_mps.copy()
        kept[list(faulty)] = np.nan
        usable = usable._replace(rate_mps=kept)
    # No explanation: no rate is used, the ranges decide alone.
    elif verdict.hypothesis in ("multiple-unknown", SYSTEM_CLOCK):
        usable = NO_RATES
    return RateVerdict(statistics.q_rate, threshold, count, verdict.hypothesis, usable, faulty)
