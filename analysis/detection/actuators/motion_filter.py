"""Learns the coefficients of the motion in flight: one Kalman filter per axis [1]_.

The terms x of a bin predict the motion of each axis as theta' x; m is the mean of the residual e,
and its covariance C is learned from its own past (docs/fdi.md, "Actuators").

References
----------
.. [1] Klein and Morelli, Aircraft System Identification, 2006, chapters 5 (equation error) and 8
   (recursive least squares).
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from analysis.detection.actuators.effects import (
    AIRSPEED,
    ANGULAR,
    AXES,
    CONSTANT,
    DOWN,
    EFFECT_SIGMA_SHARE,
    FORCE,
    FORWARD_BY_AIRSPEED,
    GUST_MPS,
    OUTPUT,
    RATE,
    TERMS,
    THROTTLE,
    Effects,
)
from analysis.detection.actuators.motion_bins import BIN_US
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2

BIN_S = BIN_US / 1e6  # the same
# Time constants of m, of C and the constant term: with twice the first a weak motor of a learned
# quad is missed, twice the last changes no row (benchmarks/actuator_watch.py).
SHORT_S, LONG_S, CONSTANT_S = 0.5, 60.0, 20.0
EARLY_SHARE = 3.0  # a memory is at most a third of the flight so far, or its start would dominate
DELAY_BINS = 8  # delay of learning: 0.8 s, above the 0.3 s that a fault needs to be confirmed
SPREAD_FROM_BIN = 10  # bins after which C is learned: before, theta is in its initial transient
# Variance of e over that of m: white noise would give 10, correlated gusts less; half or twice
# changes the delays of benchmarks/actuator_watch.py by 0.3 s.
NOISE_PER_SPREAD = 3.0
FIRST_SPREAD = 0.03  # variance of m before the flight: half or twice changes them by 0.2 s
UNOBSERVED_VARIANCE = 1e6  # variance of an axis that is not observed
MOST_SIGMAS = 3.0  # e is clipped to three sigma: p 0.3 %
# m' inv(V) m above which m has less weight in C, chi2inv(0.875, 6): without it the throttle of
# `motor-efficiency` is isolated 0.5 s later (benchmarks/preset_table.py).
MEAN_OUTLIER_STATISTIC = 10.0
# A learned rotor: 5 sigma (p 6e-7), and some lift, part of which reactions to gusts hide.
KNOWN_SIGMAS, LEARNED_LIFT_MPS2 = 5.0, -0.3


@dataclass(slots=True)
class MotionModel:
    """The model of the motion.

    `theta` (AXES, TERMS) with covariances `p` (AXES, TERMS, TERMS); `mean` (AXES,) is m, `spread`
    (AXES, AXES) is C, `nonlinearity` (AXES,) the part of m that the linear model cannot predict;
    `mean_terms` (TERMS,) are the terms that it is linear about; `error` and `doubt` (AXES,): e and
    the variance of theta' x. `waiting` are terms, motion, m and its statistic of bins that wait for
    learning, `bins` the number since the start.
    """

    effects: Effects
    theta: Vector
    p: Vector
    mean: Vector = field(default_factory=lambda: np.zeros(AXES))
    spread: Vector = field(default_factory=lambda: FIRST_SPREAD * np.eye(AXES))
    nonlinearity: Vector = field(default_factory=lambda: np.zeros(AXES))
    mean_terms: Vector = field(default_factory=lambda: np.zeros(TERMS))
    error: Vector = field(default_factory=lambda: np.zeros(AXES))
    doubt: Vector = field(default_factory=lambda: np.zeros(AXES))
    waiting: deque[tuple[Vector, Vector, Vector, float]] = field(default_factory=deque)
    bins: int = 0

    def reset(self) -> None:
        """Begin a flight; what was learned is kept."""
        self.bins = 0
        self.waiting.clear()
        self.mean, self.nonlinearity = np.zeros(AXES), np.zeros(AXES)

    def known_rotors(self) -> NDArray[np.bool_]:
        """Which outputs (COMMANDS,) of an unknown vehicle are known to lift it."""
        effects = self.theta[:, OUTPUT:RATE]
        variances = np.diagonal(self.p, axis1=1, axis2=2)[:, OUTPUT:RATE]
        surest = (effects**2 / variances).max(axis=0)
        known: NDArray[np.bool_] = (effects[DOWN] < LEARNED_LIFT_MPS2) & (surest > KNOWN_SIGMAS**2)
        return known

    def has_airspeed(self, terms: Vector) -> bool:
        """Whether the axis with the airspeed can be predicted for a bin."""
        return bool(terms[AIRSPEED] > 0.0 and self.theta[FORWARD_BY_AIRSPEED, AIRSPEED] != 0.0)

    def scale_terms(self, terms: Vector) -> Vector:
        """The terms (AXES, TERMS) of each axis, scaled by the airspeed where it is known."""
        scaled = np.tile(terms, (AXES, 1))
        scaled[DOWN, FORCE:] = 0.0
        if (counts := self.effects.throttle) is not None:
            column = OUTPUT + self.effects.names.index(THROTTLE)
            levels = np.linspace(0.0, 1.0, counts.shape[1])
            scaled[:, column] = [np.interp(terms[column], levels, axis) for axis in counts]
        if terms[AIRSPEED] > 0.0:
            scaled[:ANGULAR] *= (terms[AIRSPEED] / self.effects.cruise_mps) ** self.effects.powers
        return scaled

    def covariance(self) -> Vector:
        """The variance (AXES, AXES) of e by the model's uncertainty."""
        return np.diag(self.doubt + self.nonlinearity**2)

    def compare_motion(self, terms: Vector, motion: Vector) -> None:
        """Predict the motion of a bin, and average the residual."""
        self._predict(self.scale_terms(terms), terms, motion)
        self._average_nonlinearity(terms)
        self.bins += 1
        self.mean += BIN_S / SHORT_S * (self.error - self.mean)

    def _predict(self, scaled: Vector, terms: Vector, motion: Vector) -> None:
        """Compute error and doubt of a bin's motion for the scaled terms."""
        self.error = motion - (self.theta * scaled).sum(axis=1)
        self.doubt = (np.matmul(self.p, scaled[:, :, None])[:, :, 0] * scaled).sum(axis=1)
        if not self.has_airspeed(terms):
            self.error[FORWARD_BY_AIRSPEED] = 0.0
            self.doubt[FORWARD_BY_AIRSPEED] = UNOBSERVED_VARIANCE

    def _average_nonlinearity(self, terms: Vector) -> None:
        """Average the nonlinear part of a bin's motion."""
        newest, along = np.zeros(AXES), self.theta[ANGULAR:DOWN]
        # Drag grows with the square of lift, and a propeller pulls less in faster air.
        lift = (terms[FORCE + 1] + STANDARD_GRAVITY_MPS2) ** 2 / (2.0 * STANDARD_GRAVITY_MPS2)
        moved = EFFECT_SIGMA_SHARE * along[:, OUTPUT:] * (terms - self.mean_terms)[OUTPUT:]
        newest[ANGULAR:DOWN] = np.sqrt((along[:, FORCE + 1] * lift) ** 2 + (moved**2).sum(axis=1))
        if terms[AIRSPEED] == 0.0:  # the scale of an unknown airspeed
            powers, cruise_mps = self.effects.powers, self.effects.cruise_mps
            by_air = (powers * self.theta[:ANGULAR] * terms).sum(axis=1)
            newest[:ANGULAR] = np.abs(by_air) * GUST_MPS / cruise_mps
        self.nonlinearity += BIN_S / SHORT_S * (newest - self.nonlinearity)

    def learn_motion(
        self, terms: Vector, motion: Vector, statistic: float, suspected: bool
    ) -> None:
        """Queue a bin and learn from the oldest one; `suspected` drops the queue.

        `statistic` is m' inv(V) m of the bin.
        """
        if suspected:
            self.waiting.clear()
            return
        self.waiting.append((terms, motion, self.mean.copy(), statistic))
        if len(self.waiting) <= DELAY_BINS:
            return
        terms, motion, mean, statistic = self.waiting.popleft()
        self._update(terms, motion)
        if self.bins > SPREAD_FROM_BIN:
            weight = min(1.0, MEAN_OUTLIER_STATISTIC / max(statistic, 1e-9))
            share = memory_share(BIN_S, LONG_S, self.bins)
            self.spread += share * (weight * np.outer(mean, mean) - self.spread)

    def _update(self, terms: Vector, motion: Vector) -> None:
        """One Kalman update per axis."""
        scaled = self.scale_terms(terms)
        self._predict(scaled, terms, motion)
        walk = memory_share(BIN_S, CONSTANT_S, self.bins)
        self.mean_terms += walk * (terms - self.mean_terms)
        noise = NOISE_PER_SPREAD * np.diagonal(self.spread)
        variance = self.doubt + noise
        most = MOST_SIGMAS * np.sqrt(variance)
        gain = np.matmul(self.p, scaled[:, :, None])[:, :, 0]
        gain[DOWN, FORCE:] = 0.0
        over = gain / variance[:, None]
        self.theta += over * np.clip(self.error, -most, most)[:, None]
        self.p -= over[:, :, None] * gain[:, None, :]
        # A random walk of k^2 times the noise gives a bin the weight k.
        self.p[:, CONSTANT, CONSTANT] += noise * walk**2


def initial_motion_model(effects: Effects) -> MotionModel:
    """The model before the flight."""
    return MotionModel(effects, effects.coefficients.copy(), effects.covariances())


def memory_share(step_s: float, memory_s: float, steps: float) -> float:
    """The weight of a step in a running mean over `memory_s`, larger in the first `steps`."""
    return max(step_s / memory_s, EARLY_SHARE / (steps + EARLY_SHARE))
