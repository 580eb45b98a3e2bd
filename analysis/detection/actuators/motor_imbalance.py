"""A motor that is told more than its fellows than it was before: it does less. Compiled.

Where commands are logged ten times a second, what they were in between is not known, and no motion
can be held against them. Their means over a second can be held against each other, though: a
quad's four motors carry four demands, so that its controller can keep it level only by giving a
motor that lost a share of its power just so much more, and the other three what they had. With y
the outputs above their mean, over how far motors are above the ground's value, a motor i that is
told more by g changes their mean by m = g (e_i - 1/4). What is left of m beside that is of other
causes: wind and loads tilt, and raise two motors and lower two.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.actuators.effects import COMMANDS
from analysis.detection.actuators.switched_off import MOTOR_RISE, OutputStates
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

MOTOR_COUNT = 4  # that a controller moves apart from each other
FAST_S, SLOW_S, SPREAD_S = 1.0, 20.0, 60.0  # memories of the mean, of what is usual, of its spread
LEARNING_S = 15.0  # of flight before anybody is suspected
CONFIRM_S, RECOVER_S, REPEAT_S = 1.5, 1.0, 1.0
LEAST_RAISE = (
    0.08  # of what a motor is told: 20 % of the power of one whose thrust grows as its square
)
RAISE_SIGMAS = 6.0  # of the usual spread
MOST_SPREAD = (
    0.12  # what these sigmas may be: where outputs are more uneven than that nothing is judged
)
MOST_LEFT_SHARE = 0.35  # of g that may be left beside it
LEAST_SPREAD = 0.004
BALANCED, NO_RESULT = -1, -2  # in the place of a motor

SQUARE, RAISED, SCORE = range(3)  # of `figures`
# Of `seconds`: flown, since a suspect alone explained it, since the blamed one was normal, since
# something was told; of `who`: suspected, blamed
FLOWN_S, HYPOTHESIS_S, NORMAL_S, SINCE_RESULT_S = range(4)
HYPOTHESIS, ISOLATED = range(2)


class MotorTrim(NamedTuple):
    """What is known of the outputs beside each other; `track_imbalance` changes it in place.

    `fast` and `slow` (COMMANDS,) are means of y over two memories; `figures` (3,): the mean square
    of m, and of the newest command the suspect's g and how many spreads that is.
    """

    fast: Vector
    slow: Vector
    figures: Vector
    seconds: Vector
    who: NDArray[np.int64]


def new_motor_trim() -> MotorTrim:
    """Nothing came yet."""
    return MotorTrim(
        np.zeros(COMMANDS), np.zeros(COMMANDS), np.zeros(3), np.zeros(4), np.full(2, BALANCED)
    )


@compiled
def reset_imbalance(trim: MotorTrim) -> None:
    """Forget a flight that is over."""
    trim.seconds[:] = 0.0
    trim.who[:] = BALANCED


@compiled
def track_imbalance(outputs: Vector, dt_s: float, known: OutputStates, trim: MotorTrim) -> int:
    """Follow outputs (COMMANDS,) in flight, `dt_s` after the last; the motor to blame, `BALANCED`
    where that can be told, or `NO_RESULT`."""
    motors, total, rise = 0, 0.0, 0.0
    for i in range(COMMANDS):
        if known.usual[i] - known.ground[i] > MOTOR_RISE:
            motors += 1
            total += outputs[i]
            rise += known.usual[i] - known.ground[i]
    if motors != MOTOR_COUNT:
        return NO_RESULT
    seconds = trim.seconds
    seconds[FLOWN_S] += dt_s
    flown_s = seconds[FLOWN_S]
    for i in range(COMMANDS):
        if known.usual[i] - known.ground[i] > MOTOR_RISE:
            above = (outputs[i] - total / MOTOR_COUNT) / (rise / MOTOR_COUNT)
            trim.fast[i] += min(1.0, dt_s / min(FAST_S, flown_s)) * (above - trim.fast[i])
        else:
            trim.fast[i] = trim.slow[i] = 0.0
    who = _find_raised_motor(trim)
    judged = flown_s > LEARNING_S and RAISE_SIGMAS * np.sqrt(trim.figures[SQUARE]) <= MOST_SPREAD
    same = who == trim.who[HYPOTHESIS]
    seconds[HYPOTHESIS_S] = (
        seconds[HYPOTHESIS_S] + dt_s if same and who != BALANCED and judged else 0.0
    )
    trim.who[HYPOTHESIS] = who
    blamed = trim.who[ISOLATED]
    # What is suspected is not learnt, unless it lasts: then it is how this vehicle flies now.
    if not judged or (
        blamed == BALANCED and (who == BALANCED or seconds[HYPOTHESIS_S] > 2.0 * CONFIRM_S)
    ):
        _learn(dt_s, trim)
    if blamed == BALANCED and seconds[HYPOTHESIS_S] >= CONFIRM_S:
        trim.who[ISOLATED], seconds[NORMAL_S], seconds[SINCE_RESULT_S] = who, 0.0, REPEAT_S
    elif blamed != BALANCED:
        normal = trim.fast[blamed] - trim.slow[blamed] < LEAST_RAISE / 2.0
        seconds[NORMAL_S] = seconds[NORMAL_S] + dt_s if normal else 0.0
        if seconds[NORMAL_S] >= RECOVER_S:
            trim.who[ISOLATED], seconds[SINCE_RESULT_S] = BALANCED, REPEAT_S
    seconds[SINCE_RESULT_S] += dt_s
    if not judged or seconds[SINCE_RESULT_S] < REPEAT_S:
        return NO_RESULT
    seconds[SINCE_RESULT_S] = 0.0
    found: int = trim.who[ISOLATED]
    return found


@compiled
def _find_raised_motor(trim: MotorTrim) -> int:
    """The motor whose raise alone explains m, if one does; g and its score stand in `figures`."""
    first, raised, square = BALANCED, 0.0, 0.0
    for i in range(COMMANDS):
        m = trim.fast[i] - trim.slow[i]
        square += m * m
        if m * MOTOR_COUNT / (MOTOR_COUNT - 1.0) > raised:
            first, raised = i, m * MOTOR_COUNT / (MOTOR_COUNT - 1.0)
    spread = max(np.sqrt(trim.figures[SQUARE]), LEAST_SPREAD)
    trim.figures[RAISED], trim.figures[SCORE] = raised, raised / spread
    # By Pythagoras: m is what the motor explains, and at right angles to it what is left.
    left = square - raised * raised * (MOTOR_COUNT - 1.0) / MOTOR_COUNT
    alone = left <= (MOST_LEFT_SHARE * raised) ** 2
    return first if alone and raised > max(LEAST_RAISE, RAISE_SIGMAS * spread) else BALANCED


@compiled
def _learn(dt_s: float, trim: MotorTrim) -> None:
    """What is usual, and its spread."""
    flown_s, square = max(trim.seconds[FLOWN_S], dt_s), 0.0
    for i in range(COMMANDS):
        m = trim.fast[i] - trim.slow[i]
        square += m * m
        trim.slow[i] += min(1.0, dt_s / min(SLOW_S, flown_s)) * m
    share = min(1.0, dt_s / min(SPREAD_S, flown_s))
    trim.figures[SQUARE] += share * (square - trim.figures[SQUARE])
