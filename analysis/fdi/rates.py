"""The same tests on the Doppler rates: they see a wrong attitude or force seconds earlier."""

from dataclasses import dataclass, replace

import numpy as np

from analysis.fdi.config import DetectorConfig
from analysis.fdi.inertial import DRIFT, correct, project
from analysis.fdi.measure import Modelled
from analysis.fdi.ranges import free_position, largest_set
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


def rate_variance(modelled: Modelled, config: DetectorConfig) -> Vector:
    """Variance (n,) of the range rates; as the ranges' it grows towards the horizon."""
    sine = np.sin(np.maximum(modelled.elevation_rad, 0.1))
    result: Vector = (config.sigma.rate_mps / np.sqrt(sine)) ** 2
    return result


def check_rates(motion: Motion, modelled: Modelled, config: DetectorConfig) -> RatesTested:
    """Test the predicted velocity against the rates."""
    fit = np.isfinite(modelled.v_mps)
    count = int(fit.sum())
    if not config.doppler or count < MIN_RATES:
        return RatesTested(None, None, 0, "none", np.zeros(len(fit), dtype=bool))
    variance = rate_variance(modelled, config)
    h, v = modelled.h_rate[fit], modelled.v_mps[fit]
    _, s = project(motion.p, h, variance[fit])
    m = np.linalg.inv(s)
    q, threshold = float(v @ m @ v), chi_square(count, config.p_other)
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
        p[DRIFT, DRIFT] += 100.0**2
        return replace(motion, p=p)
    return motion


def use_rates(motion: Motion, modelled: Modelled, fit: Vector, config: DetectorConfig) -> Motion:
    """Update with the rates that fit."""
    if not fit.any():
        return motion
    h = np.ascontiguousarray(modelled.h_rate[fit])
    ph, s = project(motion.p, h, rate_variance(modelled, config)[fit])
    x, p = correct(motion.x, motion.p, ph @ np.linalg.inv(s), ph, modelled.v_mps[fit])
    return replace(motion, x=x, p=p)
