"""Finds the actuator whose deficit explains the motion residual (docs/fdi.md, "Actuators").

Actuator i, which does less than its command by g, leaves the mean residual m = -b_i g, where b_i is
its column of coefficients. If two explain it equally, both are named (two ailerons).
"""

from typing import NamedTuple

import numpy as np

from analysis.detection.actuators.effects import (
    COMMANDS,
    DOWN,
    EFFECT_SIGMA_SHARE,
    FORWARD_BY_AIRSPEED,
    OUTPUT,
)
from analysis.detection.actuators.motion_filter import MotionModel
from analysis.samples.sample import Vector

OUTLIER_STATISTIC = 16.8  # m' inv(V) m above which learning pauses: chi2inv(0.99, 6)
# Gains over no hypothesis and the next one: no false isolation in benchmarks/actuator_watch.py.
DETECTION_SCORE, ISOLATION_SCORE = 25.0, 8.0
# Largest remainder: chi2inv(0.999, 6) is 22.5; the share allows for a nonlinear effect. Without it
# a faulty pitot tube is a weak elevator.
MOST_LEFT, MOST_LEFT_SHARE = 22.0, 0.08
LEAST_DEFICIT = 0.05  # of full command: EFFECT_SIGMA_SHARE of a third of it, as in hover
# A rotor rarely does more than commanded: without this `propeller-damage` seems to do so
# (benchmarks/preset_table.py). Less lift than a fifth of the weight is no rotor.
RAISED_PENALTY, ROTOR_LIFT_MPS2 = 8.0, -2.0
ROLL, PITCH, YAW = range(3)  # of the angular axes
MOST_LOAD_DEFICIT = 0.5  # elevator deficit that a shifting load can cause
NO_HYPOTHESIS, LOAD, PITOT = -1, COMMANDS, COMMANDS + 1  # stand for an actuator's index


class ActuatorHypothesis(NamedTuple):
    """The result of one test: m' inv(V) m, the actuator that explains it best with its deficit, and
    a second one that explains it equally well; NO_HYPOTHESIS where there is none. `share` replaces
    the deficit if the regression over seconds found the fault: the lost share of the command."""

    statistic: float
    first: int = NO_HYPOTHESIS
    second: int = NO_HYPOTHESIS
    deficit: float = 0.0
    share: float = 0.0


def find_hypothesis(covariance: Vector, model: MotionModel) -> ActuatorHypothesis:
    """The actuator that explains m of covariance V (AXES, AXES); of an unknown vehicle only known
    rotors are considered."""
    mean = model.mean
    information = np.asarray(np.linalg.inv(covariance), float)
    statistic = float(mean @ information @ mean)
    if statistic < DETECTION_SCORE:
        return ActuatorHypothesis(statistic)
    null_score = statistic + float(np.linalg.slogdet(covariance)[1])
    possible = model.known_rotors() if model.effects.unknown else np.ones(COMMANDS, bool)
    scores = [(null_score, NO_HYPOTHESIS, 0.0, 0.0)]
    for i in np.flatnonzero(possible).tolist():
        effect = model.theta[:, OUTPUT + i]
        known = effect @ information @ effect
        if known > 1e-9:  # else it has no effect
            guess = float(-(effect @ information @ mean) / known)
            variance = guess**2 * model.p[:, OUTPUT + i, OUTPUT + i]
            scores.append(_score_hypothesis(mean, covariance, effect, guess, variance, i))
    best, first, deficit, rest = min(scores)
    # Two other hypotheses explain one axis each: a shifting load and a faulty pitot tube.
    if first != NO_HYPOTHESIS:
        loaded = abs(deficit) < MOST_LOAD_DEFICIT and _is_elevator(model.theta[:, OUTPUT + first])
        others = [(PITOT, FORWARD_BY_AIRSPEED), *([(LOAD, PITCH)] if loaded else [])]
        for other, axis in others:
            along = information[axis] @ mean
            scores.append((null_score - along**2 / information[axis, axis], other, 0.0, 0.0))
    second_score, second, *_ = min(
        (one for one in scores if one[1] != first), default=(null_score, NO_HYPOTHESIS)
    )
    accepted = null_score - best > DETECTION_SCORE and rest < max(
        MOST_LEFT, MOST_LEFT_SHARE * statistic
    )
    no_actuator = second == PITOT and best - second_score > ISOLATION_SCORE
    if not accepted or no_actuator or abs(deficit) < LEAST_DEFICIT:
        return ActuatorHypothesis(statistic)
    second = second if second_score - best < ISOLATION_SCORE else NO_HYPOTHESIS
    return ActuatorHypothesis(statistic, first, second, deficit)


def _is_elevator(effect: Vector) -> bool:
    """Whether an effect (AXES,) is an elevator's; a shifting load has a similar one."""
    return bool(effect[DOWN] >= ROTOR_LIFT_MPS2 and abs(effect[PITCH]) > abs(effect[ROLL]))


def _score_hypothesis(
    mean: Vector, covariance: Vector, effect: Vector, guess: float, variance: Vector, i: int
) -> tuple[float, int, float, float]:
    """Score, actuator, deficit and remainder of a hypothesis, from a first guess of the deficit and
    the variance (AXES,) that the actuator's effect then adds."""
    unknown = guess * EFFECT_SIGMA_SHARE * effect
    rotor = effect[DOWN] < ROTOR_LIFT_MPS2
    if rotor:
        # A broken propeller loses lift but keeps its drag, which yaws the body.
        unknown[YAW] = guess * effect[YAW]
    own = covariance + np.diag(variance + unknown**2)
    information = np.linalg.inv(own)
    along, known = effect @ information @ mean, effect @ information @ effect
    remaining = mean @ information @ mean - along * along / known
    score = remaining + np.linalg.slogdet(own)[1]
    if rotor and along > 0.0:
        score += RAISED_PENALTY
    return float(score), i, float(-along / known), float(remaining)
