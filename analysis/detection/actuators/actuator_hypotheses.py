"""Whose deficit explains what remains of the motion, compiled: one hypothesis an actuator.

An actuator i that does less than its command by g leaves m = -b_i g, where b_i is its column of
coefficients. With V the covariance of m while all is well, that hypothesis adds what is not known
of b_i, g^2 var(b_i), and leaves

    q_i = min over g of (m + b_i g)' inv(V_i) (m + b_i g),   score s_i = q_i + ln det V_i,

against q_0 = m' inv(V) m of nobody. It is believed if its score is far better than nobody's, if
what is left fits, and if the deficit is one that matters; it names its actuator alone if its score
is better than the next actuator's, and both of them if not (two ailerons turn a wing alike).
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

OUTLIER_STATISTIC = 16.8  # m' inv(V) m beyond which nothing is learnt for a while: chi2inv(0.99, 6)
DETECTION_SCORE, ISOLATION_SCORE = 25.0, 8.0  # scores better than nobody's, and than the next one's
# What is left may be as large as this, or this share of what there was: the model is linear.
MOST_LEFT, MOST_LEFT_SHARE = 22.0, 0.08
LEAST_DEFICIT = 0.05  # of a command of 1
# A rotor that does more than its command is rare: it has to be stuck higher than it is wanted.
RAISED_PENALTY, ROTOR_LIFT_MPS2 = 8.0, -2.0
ROLL, PITCH, YAW = range(3)  # among the axes
# Of a learnt effect: sigmas, and what lifts: a controller that meets gusts hides a part of it
KNOWN_SIGMAS, LEARNED_LIFT_MPS2 = 5.0, -0.3
MOST_LOAD_DEFICIT = 0.5  # deficit of an elevator: what a load may do that slides
NO_HYPOTHESIS, LOAD, PITOT = -1, COMMANDS, COMMANDS + 1  # in the place of an actuator


class ActuatorHypothesis(NamedTuple):
    """m' inv(V) m, the actuator that explains it best and its deficit, and another one, if it
    explains it as well; NOBODY where none does. `share` is what is lost of its command, where that
    was told over seconds, in place of a deficit."""

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
    mean: Vector, usual: Vector, theta: Vector, p: Vector, rotors_alone: bool
) -> ActuatorHypothesis:
    """Who explains m (AXES,), with V (AXES, AXES), and theta with its covariances; of an unknown
    vehicle known rotors alone are asked."""
    information = invert_positive_definite(usual)
    statistic = _product(mean, information, mean)
    if statistic < DETECTION_SCORE:
        return ActuatorHypothesis(statistic, NO_HYPOTHESIS, NO_HYPOTHESIS, 0.0, 0.0)
    nobody = statistic + math.log(np.linalg.det(usual))
    first, second, best, following, deficit, rest = (
        NO_HYPOTHESIS,
        NO_HYPOTHESIS,
        nobody,
        nobody,
        0.0,
        0.0,
    )
    for i in range(COMMANDS):
        effect = theta[:, OUTPUT + i].copy()
        known = _product(effect, information, effect)
        if known <= 1e-9 or (rotors_alone and not is_known_rotor(i, theta, p)):  # it drives nothing
            continue
        guess = -_product(effect, information, mean) / known
        score, remaining, found = _score_hypothesis(
            mean,
            usual,
            effect,
            guess,
            p[:, OUTPUT + i, OUTPUT + i],
        )
        if score < best:
            second, following = first, best
            first, best, deficit, rest = i, score, found, remaining
        elif score < following:
            second, following = i, score
    # Two more explain one axis each: a load that slides, and a pitot tube.
    loaded = (
        first != NO_HYPOTHESIS
        and abs(deficit) < MOST_LOAD_DEFICIT
        and _is_elevator(theta[:, OUTPUT + first])
    )
    for other, axis, may in (
        (LOAD, PITCH, loaded),
        (PITOT, FORWARD_BY_AIRSPEED, first != NO_HYPOTHESIS),
    ):
        along = (information[axis] * mean).sum()
        score = nobody - along**2 / information[axis, axis]
        if may and score < following:
            second, following = other, score
    believed = nobody - best > DETECTION_SCORE and rest < max(
        MOST_LEFT, MOST_LEFT_SHARE * statistic
    )
    no_actuator = second == PITOT and best - following > ISOLATION_SCORE
    if not believed or no_actuator or abs(deficit) < LEAST_DEFICIT:
        return ActuatorHypothesis(statistic, NO_HYPOTHESIS, NO_HYPOTHESIS, 0.0, 0.0)
    second = second if following - best < ISOLATION_SCORE else NO_HYPOTHESIS
    return ActuatorHypothesis(statistic, first, second, deficit, 0.0)


@compiled
def _is_elevator(effect: Vector) -> bool:
    """Whether an effect (AXES,) is that of an elevator, which a load that slides is like."""
    rotor = effect[DOWN] < ROTOR_LIFT_MPS2
    return not rotor and abs(effect[PITCH]) > abs(effect[ROLL])


@compiled
def _score_hypothesis(
    mean: Vector, usual: Vector, effect: Vector, guess: float, variance: Vector
) -> tuple[float, float, float]:
    """Score of the hypothesis of one actuator, what it leaves, and the deficit, of a first guess
    and the variance (AXES,) of the actuator's effect."""
    own = usual.copy()
    rotor = effect[DOWN] < ROTOR_LIFT_MPS2
    for axis in range(AXES):
        # A broken propeller loses lift, but not its drag, which turns the body about z.
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
