"""Whether actuators follow their commands, over seconds, compiled: one regression a hypothesis.

An actuator that lost a share g of its effect, or is stuck (g = 1), leaves less of each of its
moves. Every half second tells how the motion missed its prediction, e, and what a hypothesis would
have made of that, s: for actuator i what its command did by the model, with the sign turned; for a
load that slides a moment about y that goes with the force along z; for a pitot tube that lies what
the airspeed is thought to do. With a trim that wanders by a few V beside noise of the covariance V,

    e = g s + trim + noise,   A = sum s' inv(V) s,   g = sum s' inv(V) e / A,   r = g^2 A,

the sums being taken over some seconds, and r what the hypothesis explains of sum e' inv(V) e. One
that is stuck may push by a constant as well. Of g the variance is 1 / A and what is not known of
the effect itself.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.actuators.actuator_hypotheses import (
    LOAD,
    NO_HYPOTHESIS,
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
BINS_PER_STEP = 5  # cells of half a second
RETENTION = 0.95  # of what was known half a second ago: 10 s
LONG_S, EARLY_SHARE = 60.0, 3.0  # memory of V, at most this part of the flight so far
OUTLIER_STATISTIC = 16.8  # e' inv(V) e beyond which e counts less for V
INITIAL_SPREADS = 2.0  # spreads of m in V before anything is known
TRIM_VARIANCES = 4.0  # variances of half a second in that of the trim
STUCK_LEAST_EXPLAINED = 6.0  # what a free constant has to explain
STUCK_SHARE = 0.4  # share of its moves that are missing, of one that is stuck since some seconds
# r of who is suspected, and g^2 over its variance; what it may leave of each degree of freedom, or
# which share; how far it is ahead of the next, in what it leaves, the least of it, and of
# another actuator which share of r: one loud half second tells more than the model knows
LEAST_EXPLAINED, LEAST_SIGNIFICANCE, MOST_LEFT, MOST_LEFT_SHARE = 30.0, 14.0, 3.0, 0.15
LEAST_LEAD, LEAST_NOISE, LEAST_LEAD_SHARE = 12.0, 0.25, 0.2
# Half seconds that V is learnt from before anybody is suspected, and of an unknown vehicle
LEARNED_STEPS, UNKNOWN_LEARNED_STEPS = 20.0, 60.0
LEAST_STEPS = 2.5  # half seconds
MOST_LOSS = 1.25  # g of an actuator
JUMP_STATISTIC = (
    150.0  # what is left of one half second after what explained those before: something new
)
EFFECT_SIGMA = 0.03  # one sigma of g: what no effect is constant to


class ResponseRegression(NamedTuple):
    """Sums over the past; `update_regression` changes them in place.

    `cells` (TERMS + AXES,) are sums of terms and e of the half second that is being filled, and
    `filled` (1,) its cells; `weight` (1,) is how many half seconds are remembered. About the means
    of s (HYPOTHESES, AXES) and of e (AXES,) there are the sums of s' inv(V) s, of s' inv(V) e
    (HYPOTHESES,) and of e' inv(V) e (1,). `usual` (AXES, AXES) is V, `learnt` (1,) the half seconds
    that it was learnt from. `explained`, `shares` and `sure` (HYPOTHESES,) are r, g and g^2 over
    its variance; `who` (2,) explains it best, and who does as well, if anybody.
    """

    cells: Vector
    filled: NDArray[np.int64]
    weight: Vector
    signals: Vector
    error: Vector
    own: Vector
    shared: Vector
    square: Vector
    usual: Vector
    learnt: Vector
    explained: Vector
    shares: Vector
    sure: Vector
    who: NDArray[np.int64]


def new_regression() -> ResponseRegression:
    """Nothing came yet."""
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
def reset_regression(kept: ResponseRegression) -> None:
    """Begin anew."""
    kept.cells[:] = 0.0
    kept.filled[0] = 0
    kept.weight[0] = 0.0
    kept.own[:] = kept.shared[:] = 0.0
    kept.square[0] = 0.0
    kept.explained[:] = 0.0
    kept.who[:] = NO_HYPOTHESIS


@compiled
def update_regression(
    terms: Vector, learnt: MotionModel, suspected: bool, kept: ResponseRegression
) -> None:
    """Take a cell's terms and error; every half second tells. Where somebody is suspected V is not
    learnt."""
    for i in range(TERMS):
        kept.cells[i] += terms[i]
    for i in range(AXES):
        kept.cells[TERMS + i] += learnt.error[i]
    kept.filled[0] += 1
    if kept.filled[0] < BINS_PER_STEP:
        return
    mean = kept.cells / BINS_PER_STEP
    kept.cells[:], kept.filled[0] = 0.0, 0
    if kept.learnt[0] == 0.0:
        kept.usual[:] = INITIAL_SPREADS * learnt.spread
    _add_step(scale_by_airspeed(mean[:TERMS], learnt), mean[TERMS:], learnt, not suspected, kept)
    _weigh_hypotheses(learnt, kept)


@compiled
def _add_step(
    seen: Vector, error: Vector, learnt: MotionModel, sound: bool, kept: ResponseRegression
) -> None:
    """Add half a second with the terms (AXES, TERMS) and e (AXES,)."""
    information = invert_positive_definite(_noise_covariance(learnt, kept))
    off = error - kept.error
    if _jumps(off, seen, information, learnt, kept):
        reset_regression(kept)
        return
    kept.weight[0] = RETENTION * kept.weight[0] + 1.0
    share = 1.0 / kept.weight[0]
    kept.error[:] += share * off
    told = multiply_vector(information, off)
    square = (off * told).sum()
    kept.square[0] = RETENTION * kept.square[0] + (1.0 - share) * square
    if sound and kept.weight[0] > EARLY_SHARE:
        kept.learnt[0] += 1.0
        memory = max(BINS_PER_STEP * BIN_S / LONG_S, EARLY_SHARE / (kept.learnt[0] + EARLY_SHARE))
        weight = min(1.0, OUTLIER_STATISTIC / max(square, 1e-9))
        for i in range(AXES):
            for j in range(AXES):
                kept.usual[i, j] += memory * (weight * off[i] * off[j] - kept.usual[i, j])
    for i in range(HYPOTHESES):
        signal = _signal(i, seen, learnt) - kept.signals[i]
        kept.signals[i] += share * signal
        own = (signal * multiply_vector(information, signal)).sum()
        kept.own[i] = RETENTION * kept.own[i] + (1.0 - share) * own
        kept.shared[i] = RETENTION * kept.shared[i] + (1.0 - share) * (signal * told).sum()


@compiled
def _jumps(
    off: Vector, seen: Vector, information: Vector, learnt: MotionModel, kept: ResponseRegression
) -> bool:
    """Whether who is suspected explains what went before, but not this e (AXES,) off its mean."""
    first = kept.who[0]
    if first == NO_HYPOTHESIS:
        return False
    rest = off - kept.shares[first] * (_signal(first, seen, learnt) - kept.signals[first])
    return bool((rest * multiply_vector(information, rest)).sum() > JUMP_STATISTIC)


@compiled
def _signal(i: int, seen: Vector, learnt: MotionModel) -> Vector:
    """What a hypothesis makes of e (AXES,) for g of 1."""
    signal = np.zeros(AXES)
    if i == LOAD:
        signal[PITCH] = seen[PITCH, FORCE + 1]
    elif i == PITOT:
        for axis in range(ANGULAR):
            for k in range(TERMS):
                signal[axis] -= learnt.powers[k] * learnt.theta[axis, k] * seen[axis, k]
    else:
        for axis in range(AXES):
            if axis != FORWARD_BY_AIRSPEED or has_airspeed_model(seen[axis], learnt):
                signal[axis] = -learnt.theta[axis, OUTPUT + i] * seen[axis, OUTPUT + i]
    return signal


@compiled
def _weigh_hypotheses(learnt: MotionModel, kept: ResponseRegression) -> None:
    """What each hypothesis explains, and who it is."""
    kept.who[:] = NO_HYPOTHESIS
    information = invert_positive_definite(_noise_covariance(learnt, kept))
    steady = multiply_vector(information, kept.error) / TRIM_VARIANCES
    total = kept.square[0] + (kept.error * steady).sum()
    for i in range(HYPOTHESES):
        kept.explained[i] = kept.shares[i] = kept.sure[i] = 0.0
        if kept.own[i] <= 1e-9 or not _is_possible(i, learnt):
            continue
        signal = kept.signals[i]
        own = kept.own[i] + (signal * multiply_vector(information, signal)).sum() / TRIM_VARIANCES
        shared = kept.shared[i] + (signal * steady).sum()
        explained = shared**2 / own
        if i < COMMANDS:
            effect = learnt.theta[:, OUTPUT + i].copy()
            effect[FORWARD_BY_AIRSPEED] = 0.0
            along = (effect * steady).sum() ** 2 / (
                effect * multiply_vector(information, effect)
            ).sum()
            held = (
                kept.shared[i] ** 2 / kept.own[i] + TRIM_VARIANCES * along - STUCK_LEAST_EXPLAINED
            )
            if held > explained and kept.shared[i] > STUCK_SHARE * kept.own[i]:
                explained, own, shared = held, kept.own[i], kept.shared[i]
            if not 0.0 < shared < MOST_LOSS * own:
                continue
        kept.explained[i], kept.shares[i] = explained, shared / own
        kept.sure[i] = kept.shares[i] ** 2 / (1.0 / own + _effect_variance(i, learnt, kept))
    known = LEARNED_STEPS if learnt.counts[UNKNOWN] == 0 else UNKNOWN_LEARNED_STEPS
    if kept.learnt[0] >= known and kept.weight[0] >= LEAST_STEPS:
        _choose_hypothesis(total, kept)


@compiled
def _is_possible(i: int, learnt: MotionModel) -> bool:
    """Whether a hypothesis counts: of an unknown vehicle known rotors, a load on wings."""
    if i >= COMMANDS:
        return bool(learnt.powers[CONSTANT] > 0.0)
    if learnt.counts[UNKNOWN] == 0:
        return True
    return is_known_rotor(i, learnt.theta, learnt.p)


@compiled
def _choose_hypothesis(total: float, kept: ResponseRegression) -> None:
    """Who explains it best of a total of sum e' inv(V) e, and who as well."""
    first = int(np.argmax(kept.explained))
    best = kept.explained[first]
    left = max(0.0, total - best) / (AXES * kept.weight[0])
    fits = left < max(MOST_LEFT, MOST_LEFT_SHARE * best / (AXES * kept.weight[0]))
    if best < LEAST_EXPLAINED or kept.sure[first] < LEAST_SIGNIFICANCE or not fits:
        return
    kept.who[0] = first
    following = 0.0
    for i in range(HYPOTHESES):
        if i != first and kept.explained[i] > following:
            following = kept.explained[i]
            alike = LEAST_LEAD_SHARE * best if first < COMMANDS and i < COMMANDS else 0.0
            if best - following < max(LEAST_LEAD * max(LEAST_NOISE, left), alike):
                kept.who[1] = i
    if kept.who[1] == PITOT or first == PITOT:
        # Noise of the airspeed scales what surfaces do: it proves nothing against them.
        kept.who[0], kept.who[1] = PITOT, NO_HYPOTHESIS
    elif first == LOAD and kept.who[1] != NO_HYPOTHESIS:
        # Of an actuator and a load it may be the actuator.
        kept.who[0], kept.who[1] = kept.who[1], first


@compiled
def _noise_covariance(learnt: MotionModel, kept: ResponseRegression) -> Vector:
    """V with what is not sure of the model (AXES, AXES)."""
    usual = kept.usual.copy()
    for axis in range(AXES):
        usual[axis, axis] += learnt.doubt[axis] + learnt.bent[axis] ** 2
    return usual


@compiled
def _effect_variance(i: int, learnt: MotionModel, kept: ResponseRegression) -> float:
    """The variance of g for what is not known of a hypothesis's effect."""
    if i >= COMMANDS:
        return 0.0
    best, doubt = 0.0, 0.0
    for axis in range(AXES):
        square = learnt.theta[axis, OUTPUT + i] ** 2
        if square > best * kept.usual[axis, axis]:
            best = square / kept.usual[axis, axis]
            doubt = learnt.p[axis, OUTPUT + i, OUTPUT + i] / square
    return EFFECT_SIGMA**2 + doubt
