"""Motors whose output is switched off in flight, compiled: what no controller does while it flies.

An output that rose at take-off drives a motor. In flight a controller keeps it above the value that
it had on the ground; there it goes back only if somebody takes it out of the controller's hands. A
landing or a stop of all motors takes all of them at once, and blames nobody; nor does one whose
wings carry it, and which parks those that lifted it, three or more.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.actuators.effects import COMMANDS
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

MOTOR_RISE = 0.1  # thousands above the ground's value: it drives a motor
OFF_SHARE, WORKING_SHARE = 0.03, 0.5  # of what it is above the ground's value on average
OFF_US = 500_000
AVERAGE_SHARE = 0.02  # of a new output in the average
LEAST_WORKING = 2  # others that go on
PARKED_COUNT = 3  # that are off are parked
UNKNOWN_US = -1


class OutputStates(NamedTuple):
    """What is known of each output; `track_outputs` changes it in place.

    `ground` and `usual` (COMMANDS,): the least before the flight, the average in it; `off_us`
    (COMMANDS,): since when it is off, later when that was told last; `gone` (COMMANDS,): whether
    it was told in this flight; `parked` (COMMANDS,): whether it is off with several others.
    """

    ground: Vector
    usual: Vector
    off_us: NDArray[np.int64]
    gone: NDArray[np.bool_]
    parked: NDArray[np.bool_]


def new_output_states() -> OutputStates:
    """Nothing came yet."""
    return OutputStates(
        np.full(COMMANDS, np.inf),
        np.full(COMMANDS, np.inf),
        np.full(COMMANDS, UNKNOWN_US),
        np.zeros(COMMANDS, np.bool_),
        np.zeros(COMMANDS, np.bool_),
    )


@compiled
def track_outputs(outputs: Vector, t_us: int, flies: bool, kept: OutputStates) -> int:
    """Follow outputs (COMMANDS,) in thousands; which one is found to be switched off, or -1."""
    found, working, off = -1, 0, 0
    for i in range(COMMANDS):
        if not flies:
            kept.ground[i] = min(kept.ground[i], outputs[i])
            kept.usual[i], kept.gone[i] = outputs[i], False
        rises = kept.usual[i] - kept.ground[i]
        above = outputs[i] - kept.ground[i]
        if flies and rises > MOTOR_RISE and above <= OFF_SHARE * rises:
            off += 1
            if kept.off_us[i] == UNKNOWN_US:
                kept.off_us[i] = t_us
            if found < 0 and t_us - kept.off_us[i] >= OFF_US and not kept.parked[i]:
                found = i
        else:
            working += rises > MOTOR_RISE and above >= WORKING_SHARE * rises
            kept.off_us[i], kept.parked[i] = UNKNOWN_US, False
            kept.usual[i] += AVERAGE_SHARE * (outputs[i] - kept.usual[i])
    if off >= PARKED_COUNT:
        kept.parked[:] |= kept.off_us != UNKNOWN_US
        return -1
    if found < 0 or working < LEAST_WORKING:
        return -1
    kept.gone[found], kept.off_us[found] = True, t_us
    return found
