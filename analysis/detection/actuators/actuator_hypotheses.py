"""Finds the actuator whose deficit explains the motion residual, compiled.

Actuator i, which does less than its command by g, leaves the mean residual m = -b_i g, where b_i is
its column of coefficients. V is the covariance of m without a fault. The hypothesis adds the
uncertainty of b_i, g^2 var(b_i), and leaves

    q_i = min over g of (m + b_i g)' inv(V_i) (m + b_i g),   score s_i = q_i + ln det V_i,

to be compared with q_0 = m' inv(V) m of no hypothesis. A hypothesis is accepted if its score is far
better, the remainder fits, and the deficit is large enough to matter. The actuator is isolated if
its score is also clearly better than the next one's; otherwise both are named (two ailerons).
"""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.actuators.effects import (
    AXES,
    COMMANDS,
    DOWN,
    EFFECT_SIGMA_SHARE,
    FORWARD_BY_AIRSPEED,
    OUTPUT,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import invert_positive_definite

OUTLIER_STATISTIC = 16.8  # m' inv(V) m above which learning pauses: chi2inv(0.99, 6)
# Gains over no hypothesis and the next one: no false isolation in benchmarks/actuator_watch.py.
DETECTION_SCORE, ISOLATION_SCORE = 25.0, 8.0
# Largest remainder: chi2inv(0.999, 6) is 22.5; the share allows for a nonlinear effect.
MOST_LEFT, MOST_LEFT_SHARE = 22.0, 0.08
LEAST_DEFICIT = 0.05  # of full command; chosen: smaller deficits do not matter
# A rotor rarely does more than commanded (if stuck above it); less lift than this is no rotor.
RAISED_PENALTY, ROTOR_LIFT_MPS2 = 8.0, -2.0
ROLL, PITCH, YAW = range(3)  # of the angular axes
# A learned rotor: 5 sigma (p 6e-7), and some lift, part of which reactions to gusts hide.
KNOWN_SIGMAS, LEARNED_LIFT_MPS2 = 5.0, -0.3
MOST_LOAD_DEFICIT = 0.5  # elevator deficit that a shifting load can cause
NO_HYPOTHESIS, LOAD, PITOT = -1, COMMANDS, COMMANDS + 1  # stand for an actuator's index


class ActuatorHypothesis(NamedTuple):
    """The result of one test: m' inv(V) m, the actuator that explains it best with its deficit, and
    a second one that explains it equally well; NO_HYPOTHESIS where there is none. `share` replaces
    the deficit if the regression over seconds found the fault: the lost share of the command."""

    statistic: float
    first: int
    second: int
    deficit: float
    share: float


@compiled
def _product(a: Vector, matrix: Vector, b: Vector) -> float:
    """a' M b of vectors (AXES,)."""
    total = 0.0
    for i in range(AXES):
        for j in range(AXES):
            total += a[i] * matrix[i, j] * b[j]
    return total


@compiled
def is_known_rotor(i: int, theta: Vector, p: Vector) -> bool:
    """Whether an output of an unknown vehicle is known to lift it."""
    lift, at = theta[DOWN, OUTPUT + i], OUTPUT + i
    surest = 0.0
    for axis in range(AXES):
        surest = max(surest, theta[axis, at] ** 2 / p[axis, at, at])
    return lift < LEARNED_LIFT_MPS2 and surest > KNOWN_SIGMAS**2


@compiled
def count_known_rotors(theta: Vector, p: Vector) -> int:
    """How many outputs are known to lift the vehicle."""
    count = 0
    for i in range(COMMANDS):
        count += is_known_rotor(i, theta, p)
    return count


@compiled
def find_hypothesis(
    mean: Vector, covariance: Vector, theta: Vector, p: Vector, rotors_alone: bool
) -> ActuatorHypothesis:
    """The actuator that explains m (AXES,) of covariance V (AXES, AXES), given theta and its
    covariances `p`; of an unknown vehicle only known rotors are considered."""
    information = invert_positive_definite(covariance)
    statistic = _product(mean, information, mean)
    if statistic < DETECTION_SCORE:
        return ActuatorHypothesis(statistic, NO_HYPOTHESIS, NO_HYPOTHESIS, 0.0, 0.0)
    null_score = statistic + math.log(np.linalg.det(covariance))
    first, second, best, second_score, deficit, rest = (
        NO_HYPOTHESIS,
        NO_HYPOTHESIS,
        null_score,
        null_score,
        0.0,
        0.0,
    )
    for i in range(COMMANDS):
        effect = theta[:, OUTPUT + i].copy()
        known = _product(effect, information, effect)
        if known <= 1e-9 or (rotors_alone and not is_known_rotor(i, theta, p)):  # it has no effect
            continue
        guess = -_product(effect, information, mean) / known
        score, remaining, found = _score_hypothesis(
            mean, covariance, effect, guess, p[:, OUTPUT + i, OUTPUT + i]
        )
        if score < best:
            second, second_score = first, best
            first, best, deficit, rest = i, score, found, remaining
        elif score < second_score:
            second, second_score = i, score
    # Two other hypotheses explain one axis each: a shifting load and a faulty pitot tube.
    loaded = (
        first != NO_HYPOTHESIS
        and abs(deficit) < MOST_LOAD_DEFICIT
        and _is_elevator(theta[:, OUTPUT + first])
    )
    for other, axis, allowed in (
        (LOAD, PITCH, loaded),
        (PITOT, FORWARD_BY_AIRSPEED, first != NO_HYPOTHESIS),
    ):
        along = (information[axis] * mean).sum()
        score = null_score - along**2 / information[axis, axis]
        if allowed and score < second_score:
            second, second_score = other, score
    accepted = null_score - best > DETECTION_SCORE and rest < max(
        MOST_LEFT, MOST_LEFT_SHARE * statistic
    )
    no_actuator = second == PITOT and best - second_score > ISOLATION_SCORE
    if not accepted or no_actuator or abs(deficit) < LEAST_DEFICIT:
        return ActuatorHypothesis(statistic, NO_HYPOTHESIS, NO_HYPOTHESIS, 0.0, 0.0)
    second = second if second_score - best < ISOLATION_SCORE else NO_HYPOTHESIS
    return ActuatorHypothesis(statistic, first, second, deficit, 0.0)


@compiled
def _is_elevator(effect: Vector) -> bool:
    """Whether an effect (AXES,) is an elevator's; a shifting load has a similar one."""
    rotor = effect[DOWN] < ROTOR_LIFT_MPS2
    return not rotor and abs(effect[PITCH]) > abs(effect[ROLL])


@compiled
def _score_hypothesis(
    mean: Vector, covariance: Vector, effect: Vector, guess: float, variance: Vector
) -> tuple[float, float, float]:
    """Score, remainder and deficit of one actuator's hypothesis, from a first guess of the deficit
    and the variance (AXES,) of the actuator's effect."""
    own = covariance.copy()
    rotor = effect[DOWN] < ROTOR_LIFT_MPS2
    for axis in range(AXES):
        # A broken propeller loses lift but keeps its drag, which yaws the body.
        share = 1.0 if rotor and axis == YAW else EFFECT_SIGMA_SHARE
        unknown = variance[axis] + (share * effect[axis]) ** 2
        own[axis, axis] += guess * guess * unknown
    information = invert_positive_definite(own)
    along = _product(effect, information, mean)
    known = _product(effect, information, effect)
    remaining = _product(mean, information, mean) - along * along / known
    score = remaining + math.log(np.linalg.det(own))
    if rotor and along > 0.0:
        score += RAISED_PENALTY
    return score, remaining, -along / known
