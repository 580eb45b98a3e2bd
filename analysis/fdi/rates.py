"""The same tests on the Doppler rates: they see a wrong attitude or force seconds earlier."""

from typing import NamedTuple

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import DRIFT, innovate
from analysis.fdi.measure import NO_ROWS, Modelled
from analysis.fdi.ranges import FREE_DRIFT_MPS, free_position, largest_set
from analysis.fdi.state import Motion
from analysis.fdi.thresholds import chi_square
from analysis.fdi.update import Assessed
from analysis.fdi.verdict import judge

MIN_RATES = 5


class RatesTested(NamedTuple):
    """What the rates said of the prediction, and those that fit."""

    statistic: float | None
    threshold: float | None
    dof: int
    hypothesis: str
    fit: Modelled


def check_rates(
    motion: Motion, modelled: Modelled, assessed: Assessed, config: DetectorConfig
) -> RatesTested:
    """Test the predicted velocity against the rates."""
    count = assessed.rates
    if not config.doppler or count < MIN_RATES:
        return RatesTested(None, None, 0, "none", NO_ROWS)
    known = modelled
    if count < len(modelled.v_mps):
        known = modelled.select(np.isfinite(modelled.v_mps))
    threshold = chi_square(count, config.p_other)
    if assessed.q_rate <= threshold:
        return RatesTested(assessed.q_rate, threshold, count, "none", known)
    h, v = known.h_rate, known.v_mps
    _, m, _, q = innovate(motion.p, h, known.rate_variance, v)
    velocity = np.ascontiguousarray(h[:, 3:6])
    drift = np.ascontiguousarray(h[:, DRIFT : DRIFT + 1])
    verdict = judge(m, v, velocity, drift, config.p_other, largest_set(count, config.left_out))
    if verdict.hypothesis == "satellites":
        keep = np.ones(count, dtype=bool)
        keep[list(verdict.subset)] = False
        known = known.select(keep)
    elif verdict.hypothesis == "multiple-unknown":
        known = NO_ROWS
    return RatesTested(q, threshold, count, verdict.hypothesis, known)


def freed_by(motion: Motion, hypothesis: str) -> Motion:
    """The filter before the ranges are used, with what the rates contradict forgotten."""
    if hypothesis == "imu":
        return free_position(motion)
    if hypothesis == "clock":
        p = motion.p.copy()
        p[DRIFT, DRIFT] += FREE_DRIFT_MPS**2
        return motion._replace(p=p)
    return motion
