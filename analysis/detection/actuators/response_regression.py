"""Tests over seconds whether actuators follow their commands: one regression each.

An actuator that lost a share g of its effect, or is stuck (g = 1), falls short by that share of
every movement. Each step of half a second gives the residual e of the motion, and the signal s that
a hypothesis predicts in it; docs/fdi.md, "Actuators", has the sums.
"""

from dataclasses import dataclass, field

import numpy as np

from analysis.detection.actuators.actuator_hypotheses import (
    LOAD,
    NO_HYPOTHESIS,
    OUTLIER_STATISTIC,
    PITCH,
    PITOT,
)
from analysis.detection.actuators.effects import (
    ANGULAR,
    AXES,
    COMMANDS,
    CONSTANT,
    FORCE,
    FORWARD_BY_AIRSPEED,
    OUTPUT,
    RATE,
    TERMS,
)
from analysis.detection.actuators.motion_filter import (
    BIN_S,
    EARLY_SHARE,
    LONG_S,
    MotionModel,
    memory_share,
)
from analysis.samples.sample import Vector

HYPOTHESES = COMMANDS + 2  # actuators, LOAD and PITOT
BINS_PER_STEP = 5  # bins of a step: half a second
RETENTION = 0.95  # per step: a memory of 10 s
TRIM_VARIANCES = 4.0  # variance of the trim over V: 2 sigma; half or twice changes no row
STUCK_LEAST_EXPLAINED = 6.0  # r that the free constant has to add: 2.4 sigma, p 0.014
STUCK_SHARE = 0.4  # least g of an actuator that has been stuck for some seconds
# Least r and least g^2 over its variance (5.5 and 3.7 sigma of one degree of freedom); largest
# remainder per degree of freedom, absolute and as a share of r; least lead over the next hypothesis
# in units of the remainder: no false isolation in benchmarks/actuator_watch.py.
LEAST_EXPLAINED, LEAST_SIGNIFICANCE, MOST_LEFT, MOST_LEFT_SHARE = 30.0, 14.0, 3.0, 0.15
LEAST_LEAD = 12.0  # the last of these
# Steps before the first test: 10 s; of an unknown vehicle 30 s: gusts led to an alarm at 29 s
LEARNED_STEPS, UNKNOWN_LEARNED_STEPS = 20.0, 60.0
LEAST_STEPS = 2.5  # steps since the last reset
MOST_LOSS = 1.25  # largest g of an actuator: 1, and room for its error
# Remainder of one step beyond the hypothesis, a new fault: without it a load is suspected beside a
# stuck elevator (benchmarks/actuator_watch.py).
JUMP_STATISTIC = 150.0
EFFECT_SIGMA = 0.03  # one sigma of g; with twice as much a weak elevator may also be a load


NO_HYPOTHESES = (NO_HYPOTHESIS, NO_HYPOTHESIS)


def _per_hypothesis() -> Vector:
    return np.zeros(HYPOTHESES)


@dataclass(slots=True)
class ResponseRegression:
    """Sums over the past.

    `terms` (TERMS,) and `errors` (AXES,) are sums over the step that is being filled. `own` and
    `shared` are the sums of s' inv(V) s and of s' inv(V) e, `square` of e' inv(V) e, about the
    means `signals` (HYPOTHESES, AXES) and `error` (AXES,); `cov` (AXES, AXES) is V. `explained`,
    `shares` and `significance` (HYPOTHESES,) are r, g and g^2 over its variance; `hypotheses` are
    the best one, and one that explains as much.
    """

    terms: Vector = field(default_factory=lambda: np.zeros(TERMS))
    errors: Vector = field(default_factory=lambda: np.zeros(AXES))
    filled: int = 0  # bins of the step
    weight: float = 0.0  # number of steps in memory
    signals: Vector = field(default_factory=lambda: np.zeros((HYPOTHESES, AXES)))
    error: Vector = field(default_factory=lambda: np.zeros(AXES))
    own: Vector = field(default_factory=_per_hypothesis)
    shared: Vector = field(default_factory=_per_hypothesis)
    square: float = 0.0
    cov: Vector = field(default_factory=lambda: np.zeros((AXES, AXES)))
    learned_steps: float = 0.0  # what V was learned from
    explained: Vector = field(default_factory=_per_hypothesis)
    shares: Vector = field(default_factory=_per_hypothesis)
    significance: Vector = field(default_factory=_per_hypothesis)
    hypotheses: tuple[int, int] = NO_HYPOTHESES

    def reset(self) -> None:
        """Start again; V is kept."""
        self.terms, self.errors, self.filled = np.zeros(TERMS), np.zeros(AXES), 0
        self.weight = self.square = 0.0
        self.own, self.shared, self.explained = (_per_hypothesis() for _ in range(3))
        self.hypotheses = NO_HYPOTHESES

    def update(self, terms: Vector, model: MotionModel, suspected: bool) -> None:
        """Add a bin, evaluate every half second; V is frozen while `suspected`."""
        self.terms += terms
        self.errors += model.error
        self.filled += 1
        if self.filled < BINS_PER_STEP:
            return
        terms, error = self.terms / BINS_PER_STEP, self.errors / BINS_PER_STEP
        self.terms, self.errors, self.filled = np.zeros(TERMS), np.zeros(AXES), 0
        if self.learned_steps == 0.0:
            self.cov = model.spread
        information = np.asarray(np.linalg.inv(self.cov + model.covariance()), float)
        self._add_step(_signals(terms, model), error, information, not suspected)
        self._weigh_hypotheses(model)

    def _add_step(self, signals: Vector, error: Vector, information: Vector, healthy: bool) -> None:
        """Add half a second with the signals and e (AXES,)."""
        change, moved, first = error - self.error, signals - self.signals, self.hypotheses[0]
        if self.explained[COMMANDS:].max() > max(LEAST_EXPLAINED, self.explained[:COMMANDS].max()):
            first = int(np.argmax(self.explained))  # a load or pitot tube, even if much is left
        if first != NO_HYPOTHESIS:
            # The hypothesis may explain the past but not this deviation.
            rest = change - self.shares[first] * moved[first]
            if rest @ information @ rest > JUMP_STATISTIC:
                self.reset()
                return
        self.weight = RETENTION * self.weight + 1.0
        share = 1.0 / self.weight
        square = float(change @ information @ change)
        if healthy and self.weight > EARLY_SHARE:
            self.learned_steps += 1.0
            memory = memory_share(BINS_PER_STEP * BIN_S, LONG_S, self.learned_steps)
            weight = min(1.0, OUTLIER_STATISTIC / max(square, 1e-9))
            self.cov = self.cov + memory * (weight * np.outer(change, change) - self.cov)
        self.error = self.error + share * change
        self.signals = self.signals + share * moved
        weighted = moved @ information
        self.square = RETENTION * self.square + (1.0 - share) * square
        self.own = RETENTION * self.own + (1.0 - share) * (weighted * moved).sum(axis=1)
        self.shared = RETENTION * self.shared + (1.0 - share) * (weighted @ change)

    def _weigh_hypotheses(self, model: MotionModel) -> None:
        """Compute what each hypothesis explains, and choose one."""
        self.hypotheses = NO_HYPOTHESES
        information = np.linalg.inv(self.cov + model.covariance())
        steady = information @ self.error / TRIM_VARIANCES
        self.explained, self.shares, self.significance = (_per_hypothesis() for _ in range(3))
        # Known rotors of an unknown vehicle; a load and a pitot tube on wings.
        unknown = model.effects.unknown
        possible = np.full(HYPOTHESES, model.effects.powers[CONSTANT] > 0.0)
        possible[:COMMANDS] = model.known_rotors() if unknown else True
        for i in np.flatnonzero(possible & (self.own > 1e-9)).tolist():
            signal = self.signals[i]
            own = self.own[i] + signal @ information @ signal / TRIM_VARIANCES
            shared = self.shared[i] + signal @ steady
            explained, doubt = shared**2 / own, 0.0
            if i < COMMANDS:
                effect = model.theta[:, OUTPUT + i].copy()
                axis = int(np.argmax(effect**2 / np.diagonal(self.cov)))
                variance = float(model.p[axis, OUTPUT + i, OUTPUT + i])
                doubt = EFFECT_SIGMA**2 + variance / effect[axis] ** 2
                effect[FORWARD_BY_AIRSPEED] = 0.0
                along = (effect @ steady) ** 2 / (effect @ information @ effect)
                held = self.shared[i] ** 2 / self.own[i] + TRIM_VARIANCES * along
                held -= STUCK_LEAST_EXPLAINED
                if held > explained and self.shared[i] > STUCK_SHARE * self.own[i]:
                    explained, own, shared = held, self.own[i], self.shared[i]
                if not 0.0 < shared < MOST_LOSS * own:
                    continue
            self.explained[i], self.shares[i] = explained, shared / own
            self.significance[i] = self.shares[i] ** 2 / (1.0 / own + doubt)
        known = UNKNOWN_LEARNED_STEPS if unknown else LEARNED_STEPS
        if self.learned_steps >= known and self.weight >= LEAST_STEPS:
            self._choose_hypothesis(self.square + float(self.error @ steady))

    def _choose_hypothesis(self, total: float) -> None:
        """Choose the one that explains most of the `total`, and one that explains as much."""
        first, other = int(np.argmax(self.explained)), NO_HYPOTHESIS
        best = self.explained[first]
        left = max(0.0, total - best) / (AXES * self.weight)
        fits = left < max(MOST_LEFT, MOST_LEFT_SHARE * best / (AXES * self.weight))
        if best < LEAST_EXPLAINED or self.significance[first] < LEAST_SIGNIFICANCE or not fits:
            return
        second = 0.0
        for i, explained in enumerate(self.explained.tolist()):
            if i != first and explained > second:
                second = explained
                if best - second < LEAST_LEAD * left:
                    other = i
        self.hypotheses = first, other
        if PITOT in self.hypotheses:
            # Airspeed noise scales the surfaces' effects, so it is no evidence against them.
            self.hypotheses = PITOT, NO_HYPOTHESIS
        elif first == LOAD and other != NO_HYPOTHESIS:
            # Of an actuator and a load the actuator is reported first.
            self.hypotheses = other, first


def _signals(terms: Vector, model: MotionModel) -> Vector:
    """The e (HYPOTHESES, AXES) that each hypothesis predicts for g of 1."""
    scaled, signals = model.scale_terms(terms), np.zeros((HYPOTHESES, AXES))
    signals[:COMMANDS] = -(model.theta * scaled)[:, OUTPUT:RATE].T
    if not model.has_airspeed(terms):
        signals[:COMMANDS, FORWARD_BY_AIRSPEED] = 0.0
    signals[LOAD, PITCH] = scaled[PITCH, FORCE + 1]
    by_air = model.effects.powers * model.theta[:ANGULAR] * scaled[:ANGULAR]
    signals[PITOT, :ANGULAR] = -by_air.sum(axis=1)
    return signals
