"""The same tests on the Doppler rates: they see a wrong attitude or force seconds earlier."""

from typing import NamedTuple

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import DRIFT, innovate
from analysis.fdi.measure import Mask, Modelled
from analysis.fdi.ranges import FREE_DRIFT_MPS, free_position, largest_set
from analysis.fdi.state import Motion
from analysis.fdi.thresholds import chi_square
from analysis.fdi.update import Assessed
from analysis.fdi.verdict import judge

MIN_RATES = 5


class RatesTested(NamedTuple):
    """What the rates said of the prediction, and which of them fit (mask over the satellites)."""

    statistic: float | None
    threshold: float | None
    dof: int
    hypothesis: str
    fit: Mask


def check_rates(
    motion: Motion, modelled: Modelled, assessed: Assessed, config: DetectorConfig
) -> RatesTested:
    """Test the predicted velocity against the rates."""
    fit, count = np.isfinite(modelled.v_mps), assessed.rates
    if not config.doppler or count < MIN_RATES:
        return RatesTested(None, None, 0, "none", np.zeros(len(fit), dtype=bool))
    threshold = chi_square(count, config.p_other)
    if assessed.q_rate <= threshold:
        return RatesTested(assessed.q_rate, threshold, count, "none", fit)
    known = modelled.select(fit)
    h, v = known.h_rate, known.v_mps
    _, m, _, q = innovate(motion.p, h, known.rate_variance, v)
    velocity = np.ascontiguousarray(h[:, 3:6])
    drift = np.ascontiguousarray(h[:, DRIFT : DRIFT + 1])
    verdict = judge(m, v, velocity, drift, config.p_other, largest_set(count, config.left_out))
    if verdict.hypothesis == "satellites":
        fit[np.flatnonzero(fit)[list(verdict.subset)]] = False
    elif verdict.hypothesis == "multiple-unknown":
        fit = np.zeros(len(fit), dtype=bool)
    return RatesTested(q, threshold, count, verdict.hypothesis, fit)


def freed_by(motion: Motion, hypothesis: str) -> Motion:
    """The filter before the ranges are used, with what the rates contradict forgotten."""
    if hypothesis == "imu":
        return free_position(motion)
    if hypothesis == "clock":
        p = motion.p.copy()
        p[DRIFT, DRIFT] += FREE_DRIFT_MPS**2
        return motion._replace(p=p)
    return motion
