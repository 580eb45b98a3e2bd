"""The same tests on the Doppler rates: they see a wrong attitude or force seconds earlier."""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.epoch_update import RateInnovations
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import DRIFT, ERROR_SIZE, ISB
from analysis.detection.filter.information import inverse_covariance
from analysis.detection.filter.measurement import NO_INNOVATIONS, Innovations, rate_geometry
from analysis.detection.isolation.assessment import LEAST_RATES, EpochStatistics
from analysis.detection.isolation.chi_square import chi_square_threshold
from analysis.detection.isolation.constellations import SYSTEM_CLOCK, group_by_system
from analysis.detection.isolation.hypotheses import select_hypothesis
from analysis.detection.isolation.range_test import FREE_DRIFT_MPS, free_position, largest_subset
from analysis.detection.values import Value

NO_RATES = RateInnovations(NO_INNOVATIONS.v_mps, NO_INNOVATIONS.rate_variance, NO_INNOVATIONS.h)


class RateVerdict(Value, frozen=True):
    """The rates' test of the prediction, those that fit, and the places among the satellites in use
    of those that were found wrong."""

    statistic: float | None
    threshold: float | None
    dof: int
    hypothesis: str
    fit: RateInnovations
    faulty: tuple[int, ...] = ()


def isolate_rates(
    motion: MotionEstimate, used: Innovations, tests: EpochStatistics, config: DetectorConfig
) -> RateVerdict:
    """Test the predicted velocity against the rates."""
    count = tests.rates
    if not config.doppler or count < LEAST_RATES:
        return RateVerdict(None, None, 0, "none", NO_RATES)
    fit = RateInnovations(used.v_mps, used.rate_variance, used.h)
    threshold = chi_square_threshold(count, config.p_other)
    if tests.q_rate <= threshold:
        return RateVerdict(tests.q_rate, threshold, count, "none", fit)
    known = np.flatnonzero(np.isfinite(fit.v))
    h, v = rate_geometry(fit.h, known), fit.v[known]
    # Only the rates that are known: a kernel knows no NaN.
    m = inverse_covariance(motion.p, h, fit.variance[known])
    velocity = np.ascontiguousarray(h[:, 3:6])
    drift = np.ascontiguousarray(h[:, DRIFT : DRIFT + 1])
    largest, p = largest_subset(count, config.left_out), config.p_other
    systems = group_by_system(used.h[known, :3], used.h[known, ISB:ERROR_SIZE])
    verdict = select_hypothesis(m, v, velocity, drift, p, largest, config.rule, systems)
    faulty: tuple[int, ...] = ()
    if verdict.hypothesis == "satellites":
        faulty = tuple(known[list(verdict.subset)].tolist())
        kept = fit.v.copy()
        kept[list(faulty)] = np.nan
        fit = fit._replace(v=kept)
    # No explanation: none of the rates is used, the ranges decide alone.
    elif verdict.hypothesis in ("multiple-unknown", SYSTEM_CLOCK):
        fit = NO_RATES
    return RateVerdict(tests.q_rate, threshold, count, verdict.hypothesis, fit, faulty)


def free_by_rates(motion: MotionEstimate, hypothesis: str) -> MotionEstimate:
    """The filter before the ranges are used, with what the rates contradict forgotten."""
    if hypothesis == "imu":
        return free_position(motion)
    if hypothesis == "clock":
        p = motion.p.copy()
        p[DRIFT, DRIFT] += FREE_DRIFT_MPS**2
        return motion._replace(p=p)
    return motion
