"""Detects a motor that needs a larger command than before relative to the others.

For commands that are too sparse to be compared with the motion (docs/watches.md): with y the
outputs above their mean, divided by the motors' mean rise above their ground value, a motor i that
is raised by g changes the mean of y by m = g (e_i - 1/4), and leaves the other three unchanged.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from analysis.detection.actuators.effects import COMMANDS
from analysis.detection.actuators.switched_off import MOTOR_RISE, OutputStates
from analysis.samples.sample import Vector

MOTOR_COUNT = 4  # a controller has four demands: the effects of more are not separable
# Memories: of the mean, ten outputs at 10 Hz; of the usual mean, longer than turns; of its spread.
FAST_S, SLOW_S, SPREAD_S = 1.0, 20.0, 60.0
LEARNING_S = 15.0  # of flight before the first test: the slow mean has settled
CONFIRM_S = 1.5  # a step is then to 78 % in the mean
LEAST_RAISE = 0.08  # of a motor's command: 20 % of its power, as thrust grows with the square
RAISE_SIGMAS = 6.0  # of the usual spread: p 2e-9 of a normal distribution
MOST_SPREAD = 0.12  # limit of these sigmas, 1.5 raises: outputs that are more uneven are not tested
MOST_LEFT_SHARE = 0.35  # largest remainder as a share of g: a third of what a pair of motors leaves
LEAST_SPREAD = 0.004  # resolution of an output: 1 us of a rise by 250
BALANCED = -1  # in place of a motor


@dataclass(slots=True)
class MotorTrim:
    """The outputs relative to each other: `fast` and `slow` (COMMANDS,) are means of y over two
    memories, `square` is the mean square of m."""

    fast: Vector = field(default_factory=lambda: np.zeros(COMMANDS))
    slow: Vector = field(default_factory=lambda: np.zeros(COMMANDS))
    square: float = 0.0
    raised: float = 0.0  # g of the newest command's hypothesis, and g over the spread
    score: float = 0.0
    hypothesis: int = BALANCED
    isolated: int = BALANCED
    flown_s: float = 0.0
    hypothesis_s: float = 0.0  # with this hypothesis
    normal_s: float = 0.0  # since the isolated motor is normal
    since_result_s: float = 0.0

    def reset(self) -> None:
        """Reset at the end of a flight."""
        self.hypothesis = self.isolated = BALANCED
        self.flown_s = self.hypothesis_s = self.normal_s = self.since_result_s = 0.0

    def track_imbalance(self, outputs: Vector, dt_s: float, states: OutputStates) -> int | None:
        """Add outputs (COMMANDS,), `dt_s` after the last; the isolated motor or BALANCED if that is
        due."""
        rises = states.average - states.ground
        motors = rises > MOTOR_RISE
        if motors.sum() != MOTOR_COUNT:
            return None
        self.flown_s += dt_s
        above = (outputs - outputs[motors].mean()) / rises[motors].mean()
        share = min(1.0, dt_s / min(FAST_S, self.flown_s))
        self.fast = np.where(motors, self.fast + share * (above - self.fast), 0.0)
        self.slow = np.where(motors, self.slow, 0.0)
        who = self._find_raised_motor()
        sigmas = RAISE_SIGMAS * math.sqrt(self.square)
        tested = self.flown_s > LEARNING_S and sigmas <= MOST_SPREAD
        lasts = who == self.hypothesis and who != BALANCED and tested
        self.hypothesis_s = self.hypothesis_s + dt_s if lasts else 0.0
        self.hypothesis = who
        # A suspected raise is learned only if it lasts: then it is the vehicle's new trim.
        usual = who == BALANCED or self.hypothesis_s > 2.0 * CONFIRM_S
        if not tested or (self.isolated == BALANCED and usual):
            self._learn(dt_s)
        if self.isolated == BALANCED and self.hypothesis_s >= CONFIRM_S:
            self.isolated, self.normal_s, self.since_result_s = who, 0.0, FAST_S
        elif self.isolated != BALANCED:
            normal = (self.fast - self.slow)[self.isolated] < LEAST_RAISE / 2.0
            self.normal_s = self.normal_s + dt_s if normal else 0.0
            if self.normal_s >= FAST_S:
                self.isolated, self.since_result_s = BALANCED, FAST_S
        self.since_result_s += dt_s
        if not tested or self.since_result_s < FAST_S:
            return None
        self.since_result_s = 0.0
        return self.isolated

    def _find_raised_motor(self) -> int:
        """The motor whose raise alone explains m, if one does."""
        m = self.fast - self.slow
        first = int(np.argmax(m))
        self.raised = max(0.0, float(m[first]) * MOTOR_COUNT / (MOTOR_COUNT - 1.0))
        spread = max(math.sqrt(self.square), LEAST_SPREAD)
        self.score = self.raised / spread
        # By Pythagoras: m is the explained part and, at right angles to it, the remainder.
        left = m @ m - self.raised**2 * (MOTOR_COUNT - 1.0) / MOTOR_COUNT
        alone = left <= (MOST_LEFT_SHARE * self.raised) ** 2
        least = max(LEAST_RAISE, RAISE_SIGMAS * spread)
        return first if alone and self.raised > least else BALANCED

    def _learn(self, dt_s: float) -> None:
        """Update the usual mean and its spread."""
        flown_s, m = max(self.flown_s, dt_s), self.fast - self.slow
        self.slow = self.slow + min(1.0, dt_s / min(SLOW_S, flown_s)) * m
        self.square += min(1.0, dt_s / min(SPREAD_S, flown_s)) * float(m @ m - self.square)
