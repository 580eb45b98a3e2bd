"""The same tests on the Doppler rates: they see a wrong attitude or force seconds earlier."""

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.epoch_update import Rates
from analysis.detection.filter.filter_state import Motion
from analysis.detection.filter.inertial import DRIFT, ERRORS, ISB
from analysis.detection.filter.information import weights
from analysis.detection.filter.measurement import NO_ROWS, Modelled, rate_rows
from analysis.detection.isolation.assessment import MIN_RATES, Statistics
from analysis.detection.isolation.chi_square import chi_square
from analysis.detection.isolation.constellations import SYSTEM_CLOCK, groups_of
from analysis.detection.isolation.hypotheses import judge
from analysis.detection.isolation.range_test import FREE_DRIFT_MPS, free_position, largest_set
from analysis.detection.values import Value

NO_RATES = Rates(NO_ROWS.v_mps, NO_ROWS.rate_variance, NO_ROWS.h)


class RatesTested(Value, frozen=True):
    """The rates' test of the prediction, those that fit, and the places among the satellites in use
    of those that were found wrong."""

    statistic: float | None
    threshold: float | None
    dof: int
    hypothesis: str
    fit: Rates
    faulty: tuple[int, ...] = ()


def check_rates(
    motion: Motion, used: Modelled, tests: Statistics, config: DetectorConfig
) -> RatesTested:
    """Test the predicted velocity against the rates."""
    count = tests.rates
    if not config.doppler or count < MIN_RATES:
        return RatesTested(None, None, 0, "none", NO_RATES)
    fit = Rates(used.v_mps, used.rate_variance, used.h)
    threshold = chi_square(count, config.p_other)
    if tests.q_rate <= threshold:
        return RatesTested(tests.q_rate, threshold, count, "none", fit)
    known = np.flatnonzero(np.isfinite(fit.v))
    h, v = rate_rows(fit.h, known), fit.v[known]
    # Only the rates that are known: a kernel knows no NaN.
    m = weights(motion.p, h, fit.variance[known])
    velocity = np.ascontiguousarray(h[:, 3:6])
    drift = np.ascontiguousarray(h[:, DRIFT : DRIFT + 1])
    largest, p = largest_set(count, config.left_out), config.p_other
    systems = groups_of(used.h[known, :3], used.h[known, ISB:ERRORS])
    verdict = judge(m, v, velocity, drift, p, largest, config.rule, systems)
    faulty: tuple[int, ...] = ()
    if verdict.hypothesis == "satellites":
        faulty = tuple(known[list(verdict.subset)].tolist())
        kept = fit.v.copy()
        kept[list(faulty)] = np.nan
        fit = fit._replace(v=kept)
    # No explanation: none of the rates is used, the ranges decide alone.
    elif verdict.hypothesis in ("multiple-unknown", SYSTEM_CLOCK):
        fit = NO_RATES
    return RatesTested(tests.q_rate, threshold, count, verdict.hypothesis, fit, faulty)


def freed_by(motion: Motion, hypothesis: str) -> Motion:
    """The filter before the ranges are used, with what the rates contradict forgotten."""
    if hypothesis == "imu":
        return free_position(motion)
    if hypothesis == "clock":
        p = motion.p.copy()
        p[DRIFT, DRIFT] += FREE_DRIFT_MPS**2
        return motion._replace(p=p)
    return motion
