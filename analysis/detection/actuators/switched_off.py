"""Detects motors whose output is switched off in flight, compiled; no controller does that.

An output that rose at take-off drives a motor. A flying controller keeps it above its value on the
ground; it returns there only if something else takes the output over. A landing or an emergency
stop takes all motors at once, and isolates none; nor does a winged vehicle that parks three or
more.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.actuators.effects import COMMANDS
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

# in thousands of us above the ground value: it drives a motor (10 % of the usual range)
MOTOR_RISE = 0.1
OFF_SHARE, WORKING_SHARE = 0.03, 0.5  # Shares of the average rise: off, and working; chosen.
OFF_US = 500_000  # confirmation time, chosen: five outputs of a log at 10 Hz
AVERAGE_SHARE = 0.02  # weight of a new output in the average: 50 outputs
LEAST_WORKING = 2  # other motors that still work
PARKED_COUNT = 3  # motors that are off together are parked
UNKNOWN_US = -1


class OutputStates(NamedTuple):
    """The state of each output; `track_outputs` changes it in place.

    `ground` and `average` (COMMANDS,): the least before the flight and the mean in it; `off_us`
    (COMMANDS,): since when it is off, reset when it is reported; `reported` (COMMANDS,): whether it
    was reported in this flight; `parked` (COMMANDS,): whether it is off with several others.
    """

    ground: Vector
    average: Vector
    off_us: NDArray[np.int64]
    reported: NDArray[np.bool_]
    parked: NDArray[np.bool_]


def new_output_states() -> OutputStates:
    """No output has come yet."""
    return OutputStates(
        np.full(COMMANDS, np.inf),
        np.full(COMMANDS, np.inf),
        np.full(COMMANDS, UNKNOWN_US),
        np.zeros(COMMANDS, np.bool_),
        np.zeros(COMMANDS, np.bool_),
    )


@compiled
def track_outputs(outputs: Vector, t_us: int, flies: bool, states: OutputStates) -> int:
    """Add outputs (COMMANDS,) in thousands of us; the one that is found switched off, or -1."""
    off_output, working, off_count = -1, 0, 0
    for i in range(COMMANDS):
        if not flies:
            states.ground[i] = min(states.ground[i], outputs[i])
            states.average[i], states.reported[i] = outputs[i], False
        rises = states.average[i] - states.ground[i]
        above = outputs[i] - states.ground[i]
        if flies and rises > MOTOR_RISE and above <= OFF_SHARE * rises:
            off_count += 1
            if states.off_us[i] == UNKNOWN_US:
                states.off_us[i] = t_us
            if off_output < 0 and t_us - states.off_us[i] >= OFF_US and not states.parked[i]:
                off_output = i
        else:
            working += rises > MOTOR_RISE and above >= WORKING_SHARE * rises
            states.off_us[i], states.parked[i] = UNKNOWN_US, False
            states.average[i] += AVERAGE_SHARE * (outputs[i] - states.average[i])
    if off_count >= PARKED_COUNT:
        states.parked[:] |= states.off_us != UNKNOWN_US
        return -1
    if off_output < 0 or working < LEAST_WORKING:
        return -1
    states.reported[off_output], states.off_us[off_output] = True, t_us
    return off_output
