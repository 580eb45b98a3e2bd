"""Detects motors whose output is switched off in flight; no controller does that.

An output that rose at take-off drives a motor; docs/watches.md has the rules.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from analysis.detection.actuators.effects import COMMANDS
from analysis.samples.sample import Vector

# in thousands of us above the ground value: it drives a motor (10 % of the usual range)
MOTOR_RISE = 0.1
# Shares of the average rise: off, and working. ArduCopter's least output in flight is 15 % of the
# range (MOT_SPIN_MIN).
OFF_SHARE, WORKING_SHARE = 0.03, 0.5
OFF_US = 500_000  # five outputs of a log at 10 Hz
AVERAGE_SHARE = 0.02  # weight of a new output in the average: 50 outputs
LEAST_WORKING = 2  # other motors that still work
PARKED_COUNT = 3  # motors that are off together are parked
UNKNOWN_US = -1  # before any stamp


@dataclass(slots=True)
class OutputStates:
    """The state of each output, arrays (COMMANDS,).

    `ground` and `average`: the least before the flight and the mean in it; `off_us`: since when it
    is off, reset when it is reported; `reported`: whether it was reported in this flight; `parked`:
    whether it is off with several others.
    """

    ground: Vector = field(default_factory=lambda: np.full(COMMANDS, np.inf))
    average: Vector = field(default_factory=lambda: np.zeros(COMMANDS))
    off_us: NDArray[np.int64] = field(default_factory=lambda: np.full(COMMANDS, UNKNOWN_US))
    reported: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(COMMANDS, bool))
    parked: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(COMMANDS, bool))

    def track_outputs(self, outputs: Vector, t_us: int, flies: bool) -> int | None:
        """Add outputs (COMMANDS,) in thousands of us; the one that is found switched off."""
        if not flies:
            self.ground, self.average = np.minimum(self.ground, outputs), outputs.copy()
            self.reported[:] = False
        rises, above = self.average - self.ground, outputs - self.ground
        motors = rises > MOTOR_RISE
        off = motors & (above <= OFF_SHARE * rises) & flies
        working = motors & ~off & (above >= WORKING_SHARE * rises)
        began = np.where(self.off_us == UNKNOWN_US, t_us, self.off_us)
        self.off_us, self.parked = np.where(off, began, UNKNOWN_US), self.parked & off
        self.average += np.where(off, 0.0, AVERAGE_SHARE * (outputs - self.average))
        if off.sum() >= PARKED_COUNT:
            self.parked |= off
            return None
        found = np.flatnonzero(off & (t_us - self.off_us >= OFF_US) & ~self.parked)
        if not len(found) or working.sum() < LEAST_WORKING:
            return None
        first = int(found[0])
        self.reported[first], self.off_us[first] = True, t_us
        return first
