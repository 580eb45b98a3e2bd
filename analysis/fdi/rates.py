"""The same tests on the Doppler rates: they see a wrong attitude or force seconds earlier."""

from dataclasses import dataclass, replace

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import DRIFT, correct, innovate
from analysis.fdi.measure import Modelled
from analysis.fdi.ranges import FREE_DRIFT_MPS, Update, free_position, largest_set
from analysis.fdi.state import Motion
from analysis.fdi.thresholds import chi_square
from analysis.fdi.verdict import judge
from analysis.samples import Vector

MIN_RATES = 5


@dataclass(frozen=True, slots=True)
class RatesTested:
    """What the rates said of the prediction, and which of them fit (mask over the satellites)."""

    statistic: float | None
    threshold: float | None
    dof: int
    hypothesis: str
    fit: Vector


def check_rates(motion: Motion, modelled: Modelled, config: DetectorConfig) -> RatesTested:
    """Test the predicted velocity against the rates."""
    fit = np.isfinite(modelled.v_mps)
    count = int(fit.sum())
    if not config.doppler or count < MIN_RATES:
        return RatesTested(None, None, 0, "none", np.zeros(len(fit), dtype=bool))
    h, v, variance = modelled.h_rate, modelled.v_mps, modelled.rate_variance
    if count < len(fit):
        h, v, variance = h[fit], v[fit], variance[fit]
    _, m, _, q = innovate(motion.p, h, variance, v)
    threshold = chi_square(count, config.p_other)
    if q <= threshold:
        return RatesTested(q, threshold, count, "none", fit)
    velocity = np.ascontiguousarray(h[:, 3:6])
    drift = np.ascontiguousarray(h[:, DRIFT : DRIFT + 1])
    verdict = judge(m, v, velocity, drift, config.p_other, largest_set(count, config.left_out))
    if verdict.hypothesis == "satellites":
        fit = fit.copy()
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
        return replace(motion, p=p)
    return motion


def use_rates(motion: Motion, modelled: Modelled, fit: Vector) -> tuple[Motion, Update | None]:
    """Update with the rates that fit."""
    which = np.flatnonzero(fit)
    if not len(which):
        return motion, None
    h, v, variance = modelled.h_rate, modelled.v_mps, modelled.rate_variance
    if len(which) < len(fit):
        h, v, variance = h[fit], v[fit], variance[fit]
    ph, m, u, _ = innovate(motion.p, h, variance, v)
    x, p, gain = correct(motion.x, motion.p, h, variance, ph, m, u)
    return replace(motion, x=x, p=p), Update(gain, m, h, v, np.full(len(which), -1))
