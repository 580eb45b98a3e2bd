"""The coefficients of the motion as they are learnt in flight, compiled: a Kalman filter an axis.

The terms x of a cell predict the motion of each axis by theta' x, theta being constant but for its
first element, the constant term, which walks: trim, load and steady wind change. What remains, e,
averaged over a short memory is m. Its spread C is learnt from its own past, so that gusts and model
errors that last count as what they are; e is taken to be white with the noise that would give m
the variance that it shows.

A cell is learnt from only some cells later, and only if nothing was suspected meanwhile: otherwise
a fault would be part of the model before it is seen [1]_.

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
SHORT_S, LONG_S, CONSTANT_S = 0.5, 60.0, 20.0  # memories of m, of C, and of the constant term
EARLY_SHARE = (
    3.0  # memories are at most this part of the flight so far, or its end would never count
)
DELAY_BINS = 8  # cells until one is learnt from
SPREAD_FROM_BIN = 10  # cells after which C is learnt: before, theta is off by its beginning
NOISE_PER_SPREAD = 3.0  # of e over that of m; 10 would be white noise
FIRST_SPREAD = 0.03  # variance of m before anything is known
UNOBSERVED_VARIANCE = 1e6  # variance of what is not told
MOST_SIGMAS = 3.0  # sigmas of e that are learnt from
MOST_SPEED_RATIO = 2.0  # airspeeds of the cruise that terms are scaled by
MEAN_OUTLIER_STATISTIC = 10.0  # m' inv(V) m beyond which m counts less for C


# Of `counts`: cells since the start, cells that wait, whether nothing was known beforehand
BINS, WAITING, UNKNOWN = range(3)


class MotionModel(NamedTuple):
    """What is known of the motion; `compare_motion` and `learn_motion` change it in place.

    `powers` (TERMS,) and `cruise_mps` as in `Effects`; `theta` (AXES, TERMS), its covariances `p`
    (AXES, TERMS, TERMS); `mean` (AXES,) is m, `spread` (AXES, AXES) is C, and `bent` (AXES,) what m
    has of a motion that is not linear; `usual` (TERMS,) are the terms that it is linear about;
    `error` and `doubt` (AXES,): e and the variance of theta' x.
    `waiting` (LATER + 1, TERMS + 2 AXES + 1): terms, motion, m and its statistic of cells that are
    not yet learnt from; `counts` (3,).
    """

    powers: Vector
    cruise_mps: float
    theta: Vector
    p: Vector
    mean: Vector
    spread: Vector
    bent: Vector
    usual: Vector
    error: Vector
    doubt: Vector
    waiting: Vector
    counts: NDArray[np.int64]


def initial_motion_model(effects: Effects) -> MotionModel:
    """What is known before the flight."""
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
def _memory_share(memory_s: float, cells: int) -> float:
    """How much a cell counts in a memory that is short at the beginning."""
    share: float = max(BIN_S / memory_s, EARLY_SHARE / (cells + EARLY_SHARE))
    return share


@compiled
def has_airspeed_model(terms: Vector, learnt: MotionModel) -> bool:
    """Whether the axis that is told the airspeed says anything of a cell."""
    known: bool = terms[AIRSPEED] > 0.0 and learnt.theta[FORWARD_BY_AIRSPEED, AIRSPEED] != 0.0
    return known


@compiled
def scale_by_airspeed(terms: Vector, learnt: MotionModel) -> Vector:
    """The terms (AXES, TERMS) of each axis, scaled by the airspeed where it is known."""
    seen = np.empty((AXES, TERMS))
    seen[:] = terms
    if terms[AIRSPEED] > 0.0:
        ratio = min(MOST_SPEED_RATIO, terms[AIRSPEED] / learnt.cruise_mps)
        for i in range(TERMS):
            if learnt.powers[i] != 0.0:
                seen[:ANGULAR, i] *= ratio ** learnt.powers[i]
    return seen


@compiled
def _predict(seen: Vector, motion: Vector, learnt: MotionModel) -> None:
    """Fill in error and doubt of the motion in a cell with these terms (AXES, TERMS)."""
    for axis in range(AXES):
        count = FORCE if axis == DOWN else TERMS
        terms = seen[axis]
        predicted = variance = 0.0
        for i in range(count):
            if terms[i] == 0.0:  # most outputs drive nothing
                continue
            predicted += learnt.theta[axis, i] * terms[i]
            for j in range(count):
                variance += terms[i] * learnt.p[axis, i, j] * terms[j]
        learnt.error[axis], learnt.doubt[axis] = motion[axis] - predicted, variance
    if not has_airspeed_model(seen[FORWARD_BY_AIRSPEED], learnt):
        learnt.error[FORWARD_BY_AIRSPEED], learnt.doubt[FORWARD_BY_AIRSPEED] = (
            0.0,
            UNOBSERVED_VARIANCE,
        )


@compiled
def compare_motion(terms: Vector, motion: Vector, learnt: MotionModel) -> None:
    """Predict the motion of a cell, and average what remains."""
    _predict(scale_by_airspeed(terms, learnt), motion, learnt)
    _average_nonlinearity(terms, learnt)
    learnt.counts[BINS] += 1
    for axis in range(AXES):
        learnt.mean[axis] += BIN_S / SHORT_S * (learnt.error[axis] - learnt.mean[axis])


@compiled
def _average_nonlinearity(terms: Vector, learnt: MotionModel) -> None:
    """Average what of a cell's motion is not linear."""
    square = (terms[FORCE + 1] + STANDARD_GRAVITY_MPS2) ** 2 / (2.0 * STANDARD_GRAVITY_MPS2)
    for axis in range(DOWN):
        bent = 0.0
        if axis >= ANGULAR:
            # What drags goes with the square of what lifts, and a propeller pulls less in faster
            # air.
            bent = (learnt.theta[axis, FORCE + 1] * square) ** 2
            for i in range(OUTPUT, TERMS):
                bent += (
                    EFFECT_SIGMA_SHARE * learnt.theta[axis, i] * (terms[i] - learnt.usual[i])
                ) ** 2
        elif terms[AIRSPEED] == 0.0:
            for i in range(TERMS):  # what an airspeed that is not known would scale
                bent += learnt.powers[i] * learnt.theta[axis, i] * terms[i]
            bent = (bent * GUST_MPS / learnt.cruise_mps) ** 2
        learnt.bent[axis] += BIN_S / SHORT_S * (np.sqrt(bent) - learnt.bent[axis])


@compiled
def learn_motion(
    terms: Vector, motion: Vector, learnt: MotionModel, statistic: float, suspected: bool
) -> None:
    """Let a cell wait, and learn from the one that has waited; `suspected` forgets all that wait.

    `statistic` is m' inv(V) m of the cell.
    """
    if suspected:
        learnt.counts[WAITING] = 0
        return
    last = learnt.counts[WAITING]
    row = learnt.waiting[last]
    row[:TERMS], row[TERMS : TERMS + AXES] = terms, motion
    row[TERMS + AXES : TERMS + 2 * AXES] = learnt.mean
    row[-1] = statistic
    if last < DELAY_BINS:
        learnt.counts[WAITING] = last + 1
        return
    first = learnt.waiting[0].copy()
    learnt.waiting[:-1] = learnt.waiting[1:].copy()
    _update(first[:TERMS], first[TERMS : TERMS + AXES], learnt)
    if learnt.counts[BINS] > SPREAD_FROM_BIN:
        mean = first[TERMS + AXES : TERMS + 2 * AXES]
        weight = min(1.0, MEAN_OUTLIER_STATISTIC / max(first[-1], 1e-9))
        share = _memory_share(LONG_S, learnt.counts[BINS])
        for i in range(AXES):
            for j in range(AXES):
                learnt.spread[i, j] += share * (weight * mean[i] * mean[j] - learnt.spread[i, j])


@compiled
def _update(terms: Vector, motion: Vector, learnt: MotionModel) -> None:
    """One Kalman update an axis."""
    seen = scale_by_airspeed(terms, learnt)
    _predict(seen, motion, learnt)
    walk = _memory_share(CONSTANT_S, learnt.counts[BINS])
    learnt.usual[:] += walk * (terms - learnt.usual)
    for axis in range(AXES):
        count = FORCE if axis == DOWN else TERMS
        noise = NOISE_PER_SPREAD * learnt.spread[axis, axis]
        variance = learnt.doubt[axis] + noise
        most = MOST_SIGMAS * np.sqrt(variance)
        error = min(most, max(-most, learnt.error[axis]))
        p, gain = learnt.p[axis], np.zeros(TERMS)
        for j in range(count):
            if seen[axis, j] != 0.0:
                for i in range(count):
                    gain[i] += p[i, j] * seen[axis, j]
        for i in range(count):
            if gain[i] == 0.0:
                continue
            learnt.theta[axis, i] += gain[i] / variance * error
            for j in range(count):
                p[i, j] -= gain[i] * gain[j] / variance
        # A share of k a cell is what a walk of k^2 times the noise leads to.
        p[CONSTANT, CONSTANT] += noise * walk * walk
