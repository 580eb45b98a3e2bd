"""Learns the coefficients of the motion in flight, compiled: one Kalman filter per axis.

The terms x of a bin predict the motion of each axis as theta' x. theta is constant except for its
first element, the constant term, which follows a random walk, as trim, load and steady wind change.
The mean of the residual e over a short memory is m. The covariance C of m is learned from its own
past, so that lasting gusts and model errors are accounted for; e is taken as white, with the noise
that would give m its observed variance.

A bin is used for learning only some bins later, and only if no fault was suspected meanwhile:
otherwise a fault would become part of the model before it is detected [1]_.

References
----------
.. [1] Klein and Morelli, Aircraft System Identification, 2006, chapters 5 (equation error) and 8
   (recursive least squares).
"""

from typing import NamedTuple

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
    TERMS,
    Effects,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2

BIN_S = 0.1
# Time constants of m, of C and the constant term, chosen.
SHORT_S, LONG_S, CONSTANT_S = 0.5, 60.0, 20.0
EARLY_SHARE = 3.0  # a memory is at most a third of the flight so far, or its start would dominate
DELAY_BINS = 8  # delay of learning: 0.8 s, above the 0.3 s that a fault needs to be confirmed
SPREAD_FROM_BIN = 10  # bins after which C is learned: before, theta is in its initial transient
# variance of e over that of m, chosen for correlated gusts; white noise would give 10
NOISE_PER_SPREAD = 3.0
FIRST_SPREAD = 0.03  # variance of m before the flight, chosen
UNOBSERVED_VARIANCE = 1e6  # variance of an axis that is not observed
MOST_SIGMAS = 3.0  # e is clipped to three sigma: p 0.3 %
MOST_SPEED_RATIO = 2.0  # bound of the airspeed's scale, in cruise speeds
MEAN_OUTLIER_STATISTIC = 10.0  # m' inv(V) m above which m has less weight in C: chi2inv(0.875, 6)


# Of `counts`: bins since the start, bins that wait, whether the vehicle is unknown
BINS, WAITING, UNKNOWN = range(3)


class MotionModel(NamedTuple):
    """The model of the motion; `compare_motion` and `learn_motion` change it in place.

    `powers` (TERMS,) and `cruise_mps` as in `Effects`; `theta` (AXES, TERMS) and its covariances
    `p` (AXES, TERMS, TERMS); `mean` (AXES,) is m, `spread` (AXES, AXES) is C, `nonlinearity`
    (AXES,) the part of m that the linear model cannot predict; `mean_terms` (TERMS,) are the terms
    that it is linear about; `error` and `doubt` (AXES,): e and the variance of theta' x. `waiting`
    (DELAY_BINS + 1, TERMS + 2 AXES + 1): terms, motion, m and its statistic of bins that wait for
    learning; `counts` (3,).
    """

    powers: Vector
    cruise_mps: float
    theta: Vector
    p: Vector
    mean: Vector
    spread: Vector
    nonlinearity: Vector
    mean_terms: Vector
    error: Vector
    doubt: Vector
    waiting: Vector
    counts: NDArray[np.int64]


def initial_motion_model(effects: Effects) -> MotionModel:
    """The model before the flight."""
    return MotionModel(
        effects.powers,
        effects.cruise_mps,
        effects.coefficients.copy(),
        effects.covariances(),
        np.zeros(AXES),
        FIRST_SPREAD * np.eye(AXES),
        np.zeros(AXES),
        np.zeros(TERMS),
        np.zeros(AXES),
        np.zeros(AXES),
        np.zeros((DELAY_BINS + 1, TERMS + 2 * AXES + 1)),
        np.array([0, 0, effects.unknown]),
    )


@compiled
def _memory_share(memory_s: float, bins: int) -> float:
    """The weight of a bin in a memory, larger in the first bins."""
    share: float = max(BIN_S / memory_s, EARLY_SHARE / (bins + EARLY_SHARE))
    return share


@compiled
def has_airspeed_model(terms: Vector, model: MotionModel) -> bool:
    """Whether the axis with the airspeed can be predicted for a bin."""
    known: bool = terms[AIRSPEED] > 0.0 and model.theta[FORWARD_BY_AIRSPEED, AIRSPEED] != 0.0
    return known


@compiled
def scale_by_airspeed(terms: Vector, model: MotionModel) -> Vector:
    """The terms (AXES, TERMS) of each axis, scaled by the airspeed where it is known."""
    scaled = np.empty((AXES, TERMS))
    scaled[:] = terms
    if terms[AIRSPEED] > 0.0:
        ratio = min(MOST_SPEED_RATIO, terms[AIRSPEED] / model.cruise_mps)
        for i in range(TERMS):
            if model.powers[i] != 0.0:
                scaled[:ANGULAR, i] *= ratio ** model.powers[i]
    return scaled


@compiled
def _predict(scaled: Vector, motion: Vector, model: MotionModel) -> None:
    """Compute error and doubt of a bin's motion for these terms (AXES, TERMS)."""
    for axis in range(AXES):
        count = FORCE if axis == DOWN else TERMS
        terms = scaled[axis]
        predicted = variance = 0.0
        for i in range(count):
            if terms[i] == 0.0:  # most outputs are unused
                continue
            predicted += model.theta[axis, i] * terms[i]
            for j in range(count):
                variance += terms[i] * model.p[axis, i, j] * terms[j]
        model.error[axis], model.doubt[axis] = motion[axis] - predicted, variance
    if not has_airspeed_model(scaled[FORWARD_BY_AIRSPEED], model):
        model.error[FORWARD_BY_AIRSPEED], model.doubt[FORWARD_BY_AIRSPEED] = (
            0.0,
            UNOBSERVED_VARIANCE,
        )


@compiled
def compare_motion(terms: Vector, motion: Vector, model: MotionModel) -> None:
    """Predict the motion of a bin, and average the residual."""
    _predict(scale_by_airspeed(terms, model), motion, model)
    _average_nonlinearity(terms, model)
    model.counts[BINS] += 1
    for axis in range(AXES):
        model.mean[axis] += BIN_S / SHORT_S * (model.error[axis] - model.mean[axis])


@compiled
def _average_nonlinearity(terms: Vector, model: MotionModel) -> None:
    """Average the nonlinear part of a bin's motion."""
    square = (terms[FORCE + 1] + STANDARD_GRAVITY_MPS2) ** 2 / (2.0 * STANDARD_GRAVITY_MPS2)
    for axis in range(DOWN):
        nonlinearity = 0.0
        if axis >= ANGULAR:
            # Drag grows with the square of lift, and a propeller pulls less in faster air.
            nonlinearity = (model.theta[axis, FORCE + 1] * square) ** 2
            for i in range(OUTPUT, TERMS):
                nonlinearity += (
                    EFFECT_SIGMA_SHARE * model.theta[axis, i] * (terms[i] - model.mean_terms[i])
                ) ** 2
        elif terms[AIRSPEED] == 0.0:
            for i in range(TERMS):  # the scale of an unknown airspeed
                nonlinearity += model.powers[i] * model.theta[axis, i] * terms[i]
            nonlinearity = (nonlinearity * GUST_MPS / model.cruise_mps) ** 2
        model.nonlinearity[axis] += (
            BIN_S / SHORT_S * (np.sqrt(nonlinearity) - model.nonlinearity[axis])
        )


@compiled
def learn_motion(
    terms: Vector, motion: Vector, model: MotionModel, statistic: float, suspected: bool
) -> None:
    """Queue a bin and learn from the oldest one; `suspected` drops the queue.

    `statistic` is m' inv(V) m of the bin.
    """
    if suspected:
        model.counts[WAITING] = 0
        return
    last = model.counts[WAITING]
    row = model.waiting[last]
    row[:TERMS], row[TERMS : TERMS + AXES] = terms, motion
    row[TERMS + AXES : TERMS + 2 * AXES] = model.mean
    row[-1] = statistic
    if last < DELAY_BINS:
        model.counts[WAITING] = last + 1
        return
    first = model.waiting[0].copy()
    model.waiting[:-1] = model.waiting[1:].copy()
    _update(first[:TERMS], first[TERMS : TERMS + AXES], model)
    if model.counts[BINS] > SPREAD_FROM_BIN:
        mean = first[TERMS + AXES : TERMS + 2 * AXES]
        weight = min(1.0, MEAN_OUTLIER_STATISTIC / max(first[-1], 1e-9))
        share = _memory_share(LONG_S, model.counts[BINS])
        for i in range(AXES):
            for j in range(AXES):
                model.spread[i, j] += share * (weight * mean[i] * mean[j] - model.spread[i, j])


@compiled
def _update(terms: Vector, motion: Vector, model: MotionModel) -> None:
    """One Kalman update per axis."""
    scaled = scale_by_airspeed(terms, model)
    _predict(scaled, motion, model)
    walk = _memory_share(CONSTANT_S, model.counts[BINS])
    model.mean_terms[:] += walk * (terms - model.mean_terms)
    for axis in range(AXES):
        count = FORCE if axis == DOWN else TERMS
        noise = NOISE_PER_SPREAD * model.spread[axis, axis]
        variance = model.doubt[axis] + noise
        most = MOST_SIGMAS * np.sqrt(variance)
        error = min(most, max(-most, model.error[axis]))
        p, gain = model.p[axis], np.zeros(TERMS)
        for j in range(count):
            if scaled[axis, j] != 0.0:
                for i in range(count):
                    gain[i] += p[i, j] * scaled[axis, j]
        for i in range(count):
            if gain[i] == 0.0:
                continue
            model.theta[axis, i] += gain[i] / variance * error
            for j in range(count):
                p[i, j] -= gain[i] * gain[j] / variance
        # A random walk of k^2 times the noise gives a bin the weight k.
        p[CONSTANT, CONSTANT] += noise * walk * walk
