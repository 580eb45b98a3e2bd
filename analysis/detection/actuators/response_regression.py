"""Tests over seconds whether actuators follow their commands, compiled: one regression each.

An actuator that lost a share g of its effect, or is stuck (g = 1), falls short by that share of
every movement. Each step of half a second gives the residual e of the motion, and the signal s that
a hypothesis predicts in it: for actuator i the modelled effect of its command, reversed; for a
shifted load a moment about y proportional to the force along z; for a faulty pitot tube the
modelled effect of the airspeed. With a trim that walks by a few V beside noise of covariance V,

    e = g s + trim + noise,   A = sum s' inv(V) s,   g = sum s' inv(V) e / A,   r = g^2 A,

where the sums extend over some seconds and r is the part of sum e' inv(V) e that the hypothesis
explains. A stuck actuator may also push by a constant. The variance of g is 1 / A plus the
uncertainty of the effect itself.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.actuators.actuator_hypotheses import (
    LOAD,
    NO_HYPOTHESIS,
    OUTLIER_STATISTIC,
    PITCH,
    PITOT,
    is_known_rotor,
)
from analysis.detection.actuators.effects import (
    ANGULAR,
    AXES,
    COMMANDS,
    CONSTANT,
    FORCE,
    FORWARD_BY_AIRSPEED,
    OUTPUT,
    TERMS,
)
from analysis.detection.actuators.motion_filter import (
    BIN_S,
    UNKNOWN,
    MotionModel,
    has_airspeed_model,
    scale_by_airspeed,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import invert_positive_definite, multiply_vector

HYPOTHESES = COMMANDS + 2  # actuators, LOAD and PITOT
BINS_PER_STEP = 5  # bins of a step: half a second
RETENTION = 0.95  # per step: a memory of 10 s
# Memory of V in seconds, at most a third of the flight so far, chosen.
LONG_S, EARLY_SHARE = 60.0, 3.0
INITIAL_SPREADS = 2.0  # V before the flight, in covariances of m, chosen
TRIM_VARIANCES = 4.0  # variance of the trim over V, chosen
STUCK_LEAST_EXPLAINED = 6.0  # r that the free constant has to add, chosen
STUCK_SHARE = 0.4  # least g of an actuator that has been stuck for some seconds
# Least r and least g^2 over its variance (5.5 and 3.7 sigma of one degree of freedom); largest
# remainder per degree of freedom, absolute and as a share of r; least lead over the next hypothesis
# in units of the remainder, the smallest unit, and for another actuator as a share of r (one
# outlier says more than the model knows). Chosen on benchmarks/actuator_watch.py.
LEAST_EXPLAINED, LEAST_SIGNIFICANCE, MOST_LEFT, MOST_LEFT_SHARE = 30.0, 14.0, 3.0, 0.15
LEAST_LEAD, LEAST_NOISE, LEAST_LEAD_SHARE = 12.0, 0.25, 0.2
# Steps before the first test: 10 s; of an unknown vehicle 30 s: gusts led to an alarm at 29 s
LEARNED_STEPS, UNKNOWN_LEARNED_STEPS = 20.0, 60.0
LEAST_STEPS = 2.5  # steps since the last reset
MOST_LOSS = 1.25  # largest g of an actuator: 1, and room for its error
JUMP_STATISTIC = 150.0  # remainder of one step beyond the hypothesis: a new fault, chosen
EFFECT_SIGMA = 0.03  # one sigma of g: no effect is constant to better than 3 %, chosen


class ResponseRegression(NamedTuple):
    """Sums over the past; `update_regression` changes them in place.

    `bins` (TERMS + AXES,) are sums of terms and e of the step that is being filled, `filled` (1,)
    its number of bins; `weight` (1,) is the number of steps in memory. About the means of s
    (HYPOTHESES, AXES) and of e (AXES,) there are the sums of s' inv(V) s, of s' inv(V) e
    (HYPOTHESES,) and of e' inv(V) e (1,). `cov` (AXES, AXES) is V, `learned_steps` (1,) what
    it was learned from. `explained`, `shares` and `significance` (HYPOTHESES,) are r, g and g^2
    over its variance; `hypotheses` (2,) are the best one, and one that explains as much.
    """

    bins: Vector
    filled: NDArray[np.int64]
    weight: Vector
    signals: Vector
    error: Vector
    own: Vector
    shared: Vector
    square: Vector
    cov: Vector
    learned_steps: Vector
    explained: Vector
    shares: Vector
    significance: Vector
    hypotheses: NDArray[np.int64]


def new_regression() -> ResponseRegression:
    """No bin has come yet."""
    return ResponseRegression(
        np.zeros(TERMS + AXES),
        np.zeros(1, np.int64),
        np.zeros(1),
        np.zeros((HYPOTHESES, AXES)),
        np.zeros(AXES),
        np.zeros(HYPOTHESES),
        np.zeros(HYPOTHESES),
        np.zeros(1),
        np.zeros((AXES, AXES)),
        np.zeros(1),
        np.zeros(HYPOTHESES),
        np.zeros(HYPOTHESES),
        np.zeros(HYPOTHESES),
        np.full(2, NO_HYPOTHESIS),
    )


@compiled
def reset_regression(state: ResponseRegression) -> None:
    """Start again; V is kept."""
    state.bins[:] = 0.0
    state.filled[0] = 0
    state.weight[0] = 0.0
    state.own[:] = state.shared[:] = 0.0
    state.square[0] = 0.0
    state.explained[:] = 0.0
    state.hypotheses[:] = NO_HYPOTHESIS


@compiled
def update_regression(
    terms: Vector, model: MotionModel, suspected: bool, state: ResponseRegression
) -> None:
    """Add a bin's terms and error; evaluate every half second; V is frozen while `suspected`."""
    for i in range(TERMS):
        state.bins[i] += terms[i]
    for i in range(AXES):
        state.bins[TERMS + i] += model.error[i]
    state.filled[0] += 1
    if state.filled[0] < BINS_PER_STEP:
        return
    mean = state.bins / BINS_PER_STEP
    state.bins[:], state.filled[0] = 0.0, 0
    if state.learned_steps[0] == 0.0:
        state.cov[:] = INITIAL_SPREADS * model.spread
    _add_step(scale_by_airspeed(mean[:TERMS], model), mean[TERMS:], model, not suspected, state)
    _weigh_hypotheses(model, state)


@compiled
def _add_step(
    scaled: Vector, error: Vector, model: MotionModel, healthy: bool, state: ResponseRegression
) -> None:
    """Add half a second with the terms (AXES, TERMS) and e (AXES,)."""
    information = invert_positive_definite(_noise_covariance(model, state))
    change = error - state.error
    if _jumps(change, scaled, information, model, state):
        reset_regression(state)
        return
    state.weight[0] = RETENTION * state.weight[0] + 1.0
    share = 1.0 / state.weight[0]
    state.error[:] += share * change
    weighted = multiply_vector(information, change)
    square = (change * weighted).sum()
    state.square[0] = RETENTION * state.square[0] + (1.0 - share) * square
    if healthy and state.weight[0] > EARLY_SHARE:
        state.learned_steps[0] += 1.0
        memory = max(
            BINS_PER_STEP * BIN_S / LONG_S, EARLY_SHARE / (state.learned_steps[0] + EARLY_SHARE)
        )
        weight = min(1.0, OUTLIER_STATISTIC / max(square, 1e-9))
        for i in range(AXES):
            for j in range(AXES):
                state.cov[i, j] += memory * (weight * change[i] * change[j] - state.cov[i, j])
    for i in range(HYPOTHESES):
        signal = _signal(i, scaled, model) - state.signals[i]
        state.signals[i] += share * signal
        own = (signal * multiply_vector(information, signal)).sum()
        state.own[i] = RETENTION * state.own[i] + (1.0 - share) * own
        state.shared[i] = RETENTION * state.shared[i] + (1.0 - share) * (signal * weighted).sum()


@compiled
def _jumps(
    change: Vector,
    scaled: Vector,
    information: Vector,
    model: MotionModel,
    state: ResponseRegression,
) -> bool:
    """Whether the hypothesis explains the past but not this deviation (AXES,) of e."""
    first = state.hypotheses[0]
    if first == NO_HYPOTHESIS:
        return False
    rest = change - state.shares[first] * (_signal(first, scaled, model) - state.signals[first])
    return bool((rest * multiply_vector(information, rest)).sum() > JUMP_STATISTIC)


@compiled
def _signal(i: int, scaled: Vector, model: MotionModel) -> Vector:
    """The e (AXES,) that a hypothesis predicts for g of 1."""
    signal = np.zeros(AXES)
    if i == LOAD:
        signal[PITCH] = scaled[PITCH, FORCE + 1]
    elif i == PITOT:
        for axis in range(ANGULAR):
            for k in range(TERMS):
                signal[axis] -= model.powers[k] * model.theta[axis, k] * scaled[axis, k]
    else:
        for axis in range(AXES):
            if axis != FORWARD_BY_AIRSPEED or has_airspeed_model(scaled[axis], model):
                signal[axis] = -model.theta[axis, OUTPUT + i] * scaled[axis, OUTPUT + i]
    return signal


@compiled
def _weigh_hypotheses(model: MotionModel, state: ResponseRegression) -> None:
    """Compute what each hypothesis explains, and choose one."""
    state.hypotheses[:] = NO_HYPOTHESIS
    information = invert_positive_definite(_noise_covariance(model, state))
    steady = multiply_vector(information, state.error) / TRIM_VARIANCES
    total = state.square[0] + (state.error * steady).sum()
    for i in range(HYPOTHESES):
        state.explained[i] = state.shares[i] = state.significance[i] = 0.0
        if state.own[i] <= 1e-9 or not _is_possible(i, model):
            continue
        signal = state.signals[i]
        own = state.own[i] + (signal * multiply_vector(information, signal)).sum() / TRIM_VARIANCES
        shared = state.shared[i] + (signal * steady).sum()
        explained = shared**2 / own
        if i < COMMANDS:
            effect = model.theta[:, OUTPUT + i].copy()
            effect[FORWARD_BY_AIRSPEED] = 0.0
            along = (effect * steady).sum() ** 2 / (
                effect * multiply_vector(information, effect)
            ).sum()
            held = (
                state.shared[i] ** 2 / state.own[i] + TRIM_VARIANCES * along - STUCK_LEAST_EXPLAINED
            )
            if held > explained and state.shared[i] > STUCK_SHARE * state.own[i]:
                explained, own, shared = held, state.own[i], state.shared[i]
            if not 0.0 < shared < MOST_LOSS * own:
                continue
        state.explained[i], state.shares[i] = explained, shared / own
        state.significance[i] = state.shares[i] ** 2 / (
            1.0 / own + _effect_variance(i, model, state)
        )
    known = LEARNED_STEPS if model.counts[UNKNOWN] == 0 else UNKNOWN_LEARNED_STEPS
    if state.learned_steps[0] >= known and state.weight[0] >= LEAST_STEPS:
        _choose_hypothesis(total, state)


@compiled
def _is_possible(i: int, model: MotionModel) -> bool:
    """Whether a hypothesis applies: known rotors of an unknown vehicle, a load on wings."""
    if i >= COMMANDS:
        return bool(model.powers[CONSTANT] > 0.0)
    if model.counts[UNKNOWN] == 0:
        return True
    return is_known_rotor(i, model.theta, model.p)


@compiled
def _choose_hypothesis(total: float, state: ResponseRegression) -> None:
    """Choose the hypothesis that explains most of the `total`, and one that explains as much."""
    first = int(np.argmax(state.explained))
    best = state.explained[first]
    left = max(0.0, total - best) / (AXES * state.weight[0])
    fits = left < max(MOST_LEFT, MOST_LEFT_SHARE * best / (AXES * state.weight[0]))
    if best < LEAST_EXPLAINED or state.significance[first] < LEAST_SIGNIFICANCE or not fits:
        return
    state.hypotheses[0] = first
    second = 0.0
    for i in range(HYPOTHESES):
        if i != first and state.explained[i] > second:
            second = state.explained[i]
            alike = LEAST_LEAD_SHARE * best if first < COMMANDS and i < COMMANDS else 0.0
            if best - second < max(LEAST_LEAD * max(LEAST_NOISE, left), alike):
                state.hypotheses[1] = i
    if state.hypotheses[1] == PITOT or first == PITOT:
        # Airspeed noise scales the surfaces' effects, so it is no evidence against them.
        state.hypotheses[0], state.hypotheses[1] = PITOT, NO_HYPOTHESIS
    elif first == LOAD and state.hypotheses[1] != NO_HYPOTHESIS:
        # Of an actuator and a load the actuator is reported first.
        state.hypotheses[0], state.hypotheses[1] = state.hypotheses[1], first


@compiled
def _noise_covariance(model: MotionModel, state: ResponseRegression) -> Vector:
    """V with the model's uncertainty (AXES, AXES)."""
    cov = state.cov.copy()
    for axis in range(AXES):
        cov[axis, axis] += model.doubt[axis] + model.nonlinearity[axis] ** 2
    return cov


@compiled
def _effect_variance(i: int, model: MotionModel, state: ResponseRegression) -> float:
    """The variance of g due to the uncertainty of a hypothesis' effect."""
    if i >= COMMANDS:
        return 0.0
    best, doubt = 0.0, 0.0
    for axis in range(AXES):
        square = model.theta[axis, OUTPUT + i] ** 2
        if square > best * state.cov[axis, axis]:
            best = square / state.cov[axis, axis]
            doubt = model.p[axis, OUTPUT + i, OUTPUT + i] / square
    return EFFECT_SIGMA**2 + doubt
