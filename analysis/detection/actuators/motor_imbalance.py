"""Detects a motor that needs a larger command than before relative to the others, compiled.

Where commands are logged only ten times a second, their values in between are unknown and cannot be
compared with the motion. Their means over a second can be compared with each other, though. A
quad's four motors serve four demands, so its controller can keep it level only by raising the
command of a motor that lost power by just that share, and leaving the other three unchanged. With y
the outputs above their mean, divided by the motors' mean rise above their ground value, a motor i
that is raised by g changes the mean of y by m = g (e_i - 1/4). Other causes leave a remainder: wind
and loads tilt the vehicle, which raises two motors and lowers two.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.actuators.effects import COMMANDS
from analysis.detection.actuators.switched_off import MOTOR_RISE, OutputStates
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

MOTOR_COUNT = 4  # the controller has four demands
# Memories of the mean, of the usual mean and of its spread, chosen.
FAST_S, SLOW_S, SPREAD_S = 1.0, 20.0, 60.0
LEARNING_S = 15.0  # of flight before the first test: the slow mean has settled
CONFIRM_S, RECOVER_S, REPEAT_S = 1.5, 1.0, 1.0
LEAST_RAISE = 0.08  # of a motor's command: 20 % of its power, as thrust grows with the square
RAISE_SIGMAS = 6.0  # of the usual spread: p 2e-9 of a normal distribution
MOST_SPREAD = 0.12  # limit of these sigmas: outputs that are more uneven are not tested, chosen
MOST_LEFT_SHARE = 0.35  # largest remainder as a share of g, chosen: a pair of motors leaves 1.2
LEAST_SPREAD = 0.004  # chosen: keeps very even outputs from raising the score
BALANCED, NO_RESULT = -1, -2  # in place of a motor

SQUARE, RAISED, SCORE = range(3)  # of `figures`
# Of `seconds`: flown, with this hypothesis, since the isolated motor is normal, since the last
# result; of `hypotheses`: the present one, the isolated one
FLOWN_S, HYPOTHESIS_S, NORMAL_S, SINCE_RESULT_S = range(4)
HYPOTHESIS, ISOLATED = range(2)


class MotorTrim(NamedTuple):
    """The outputs relative to each other; `track_imbalance` changes it in place.

    `fast` and `slow` (COMMANDS,) are means of y over two memories; `values` (3,): the mean square
    of m, and of the newest command the hypothesis' g and g over the spread.
    """

    fast: Vector
    slow: Vector
    values: Vector
    seconds: Vector
    hypotheses: NDArray[np.int64]


def new_motor_trim() -> MotorTrim:
    """No output has come yet."""
    return MotorTrim(
        np.zeros(COMMANDS), np.zeros(COMMANDS), np.zeros(3), np.zeros(4), np.full(2, BALANCED)
    )


@compiled
def reset_imbalance(trim: MotorTrim) -> None:
    """Reset at the end of a flight."""
    trim.seconds[:] = 0.0
    trim.hypotheses[:] = BALANCED


@compiled
def track_imbalance(outputs: Vector, dt_s: float, states: OutputStates, trim: MotorTrim) -> int:
    """Add outputs (COMMANDS,), `dt_s` after the last; the isolated motor, BALANCED or NO_RESULT."""
    motors, total, rise = 0, 0.0, 0.0
    for i in range(COMMANDS):
        if states.average[i] - states.ground[i] > MOTOR_RISE:
            motors += 1
            total += outputs[i]
            rise += states.average[i] - states.ground[i]
    if motors != MOTOR_COUNT:
        return NO_RESULT
    seconds = trim.seconds
    seconds[FLOWN_S] += dt_s
    flown_s = seconds[FLOWN_S]
    for i in range(COMMANDS):
        if states.average[i] - states.ground[i] > MOTOR_RISE:
            above = (outputs[i] - total / MOTOR_COUNT) / (rise / MOTOR_COUNT)
            trim.fast[i] += min(1.0, dt_s / min(FAST_S, flown_s)) * (above - trim.fast[i])
        else:
            trim.fast[i] = trim.slow[i] = 0.0
    who = _find_raised_motor(trim)
    tested = flown_s > LEARNING_S and RAISE_SIGMAS * np.sqrt(trim.values[SQUARE]) <= MOST_SPREAD
    same = who == trim.hypotheses[HYPOTHESIS]
    seconds[HYPOTHESIS_S] = (
        seconds[HYPOTHESIS_S] + dt_s if same and who != BALANCED and tested else 0.0
    )
    trim.hypotheses[HYPOTHESIS] = who
    isolated = trim.hypotheses[ISOLATED]
    # A suspected raise is learned only if it lasts: then it is the vehicle's new trim.
    if not tested or (
        isolated == BALANCED and (who == BALANCED or seconds[HYPOTHESIS_S] > 2.0 * CONFIRM_S)
    ):
        _learn(dt_s, trim)
    if isolated == BALANCED and seconds[HYPOTHESIS_S] >= CONFIRM_S:
        trim.hypotheses[ISOLATED], seconds[NORMAL_S], seconds[SINCE_RESULT_S] = who, 0.0, REPEAT_S
    elif isolated != BALANCED:
        normal = trim.fast[isolated] - trim.slow[isolated] < LEAST_RAISE / 2.0
        seconds[NORMAL_S] = seconds[NORMAL_S] + dt_s if normal else 0.0
        if seconds[NORMAL_S] >= RECOVER_S:
            trim.hypotheses[ISOLATED], seconds[SINCE_RESULT_S] = BALANCED, REPEAT_S
    seconds[SINCE_RESULT_S] += dt_s
    if not tested or seconds[SINCE_RESULT_S] < REPEAT_S:
        return NO_RESULT
    seconds[SINCE_RESULT_S] = 0.0
    found: int = trim.hypotheses[ISOLATED]
    return found


@compiled
def _find_raised_motor(trim: MotorTrim) -> int:
    """The motor whose raise alone explains m, if one does; g and its score are put in `values`."""
    first, raised, square = BALANCED, 0.0, 0.0
    for i in range(COMMANDS):
        m = trim.fast[i] - trim.slow[i]
        square += m * m
        if m * MOTOR_COUNT / (MOTOR_COUNT - 1.0) > raised:
            first, raised = i, m * MOTOR_COUNT / (MOTOR_COUNT - 1.0)
    spread = max(np.sqrt(trim.values[SQUARE]), LEAST_SPREAD)
    trim.values[RAISED], trim.values[SCORE] = raised, raised / spread
    # By Pythagoras: m is the explained part and, at right angles to it, the remainder.
    left = square - raised * raised * (MOTOR_COUNT - 1.0) / MOTOR_COUNT
    alone = left <= (MOST_LEFT_SHARE * raised) ** 2
    return first if alone and raised > max(LEAST_RAISE, RAISE_SIGMAS * spread) else BALANCED


@compiled
def _learn(dt_s: float, trim: MotorTrim) -> None:
    """Update the usual mean and its spread."""
    flown_s, square = max(trim.seconds[FLOWN_S], dt_s), 0.0
    for i in range(COMMANDS):
        m = trim.fast[i] - trim.slow[i]
        square += m * m
        trim.slow[i] += min(1.0, dt_s / min(SLOW_S, flown_s)) * m
    share = min(1.0, dt_s / min(SPREAD_S, flown_s))
    trim.values[SQUARE] += share * (square - trim.values[SQUARE])
