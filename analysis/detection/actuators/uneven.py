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
from analysis.detection.actuators.switched_off import RISES, Outputs
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled

MOTORS = 4  # that a controller moves apart from each other
FAST_S, SLOW_S, SPREAD_S = 1.0, 20.0, 60.0  # memories of the mean, of what is usual, of its spread
LEARNT_S = 15.0  # of flight before anybody is suspected
LASTS_S, BACK_S, AGAIN_S = 1.5, 1.0, 1.0
LEAST = 0.08  # of what a motor is told: 20 % of the power of one whose thrust grows as its square
SIGMAS = 6.0  # of the usual spread
SEEN = 0.12  # what these sigmas may be: where outputs are more uneven than that nothing is judged
LEFT = 0.35  # of g that may be left beside it
LEAST_SPREAD = 0.004
OBEYS, SILENT = -1, -2  # in the place of a motor

SQUARE, RAISED, SCORE = range(3)  # of `figures`
# Of `seconds`: flown, since a suspect alone explained it, since the blamed one was normal, since
# something was told; of `who`: suspected, blamed
FLOWN, RUN, NORMAL, TOLD = range(4)
SUSPECT, BLAMED = range(2)


class Trim(NamedTuple):
    """What is known of the outputs beside each other; `compare` changes it in place.

    `fast` and `slow` (COMMANDS,) are means of y over two memories; `figures` (3,): the mean square
    of m, and of the newest command the suspect's g and how many spreads that is.
    """

    fast: Vector
    slow: Vector
    figures: Vector
    seconds: Vector
    who: NDArray[np.int64]


def no_trim() -> Trim:
    """Nothing came yet."""
    return Trim(np.zeros(COMMANDS), np.zeros(COMMANDS), np.zeros(3), np.zeros(4), np.full(2, OBEYS))


@compiled
def settle(trim: Trim) -> None:
    """Forget a flight that is over."""
    trim.seconds[:] = 0.0
    trim.who[:] = OBEYS


@compiled
def compare(outputs: Vector, dt_s: float, known: Outputs, trim: Trim) -> int:
    """Follow outputs (COMMANDS,) in flight, `dt_s` after the last; the motor to blame, `OBEYS`
    where that can be told, or `SILENT`."""
    motors, total, rise = 0, 0.0, 0.0
    for i in range(COMMANDS):
        if known.usual[i] - known.ground[i] > RISES:
            motors += 1
            total += outputs[i]
            rise += known.usual[i] - known.ground[i]
    if motors != MOTORS:
        return SILENT
    seconds = trim.seconds
    seconds[FLOWN] += dt_s
    flown_s = seconds[FLOWN]
    for i in range(COMMANDS):
        if known.usual[i] - known.ground[i] > RISES:
            above = (outputs[i] - total / MOTORS) / (rise / MOTORS)
            trim.fast[i] += min(1.0, dt_s / min(FAST_S, flown_s)) * (above - trim.fast[i])
        else:
            trim.fast[i] = trim.slow[i] = 0.0
    who = _suspect(trim)
    judged = flown_s > LEARNT_S and SIGMAS * np.sqrt(trim.figures[SQUARE]) <= SEEN
    same = who == trim.who[SUSPECT]
    seconds[RUN] = seconds[RUN] + dt_s if same and who != OBEYS and judged else 0.0
    trim.who[SUSPECT] = who
    blamed = trim.who[BLAMED]
    # What is suspected is not learnt, unless it lasts: then it is how this vehicle flies now.
    if not judged or (blamed == OBEYS and (who == OBEYS or seconds[RUN] > 2.0 * LASTS_S)):
        _learn(dt_s, trim)
    if blamed == OBEYS and seconds[RUN] >= LASTS_S:
        trim.who[BLAMED], seconds[NORMAL], seconds[TOLD] = who, 0.0, AGAIN_S
    elif blamed != OBEYS:
        normal = trim.fast[blamed] - trim.slow[blamed] < LEAST / 2.0
        seconds[NORMAL] = seconds[NORMAL] + dt_s if normal else 0.0
        if seconds[NORMAL] >= BACK_S:
            trim.who[BLAMED], seconds[TOLD] = OBEYS, AGAIN_S
    seconds[TOLD] += dt_s
    if not judged or seconds[TOLD] < AGAIN_S:
        return SILENT
    seconds[TOLD] = 0.0
    found: int = trim.who[BLAMED]
    return found


@compiled
def _suspect(trim: Trim) -> int:
    """The motor whose raise alone explains m, if one does; g and its score stand in `figures`."""
    first, raised, square = OBEYS, 0.0, 0.0
    for i in range(COMMANDS):
        m = trim.fast[i] - trim.slow[i]
        square += m * m
        if m * MOTORS / (MOTORS - 1.0) > raised:
            first, raised = i, m * MOTORS / (MOTORS - 1.0)
    spread = max(np.sqrt(trim.figures[SQUARE]), LEAST_SPREAD)
    trim.figures[RAISED], trim.figures[SCORE] = raised, raised / spread
    # By Pythagoras: m is what the motor explains, and at right angles to it what is left.
    left = square - raised * raised * (MOTORS - 1.0) / MOTORS
    alone = left <= (LEFT * raised) ** 2
    return first if alone and raised > max(LEAST, SIGMAS * spread) else OBEYS


@compiled
def _learn(dt_s: float, trim: Trim) -> None:
    """What is usual, and its spread."""
    flown_s, square = max(trim.seconds[FLOWN], dt_s), 0.0
    for i in range(COMMANDS):
        m = trim.fast[i] - trim.slow[i]
        square += m * m
        trim.slow[i] += min(1.0, dt_s / min(SLOW_S, flown_s)) * m
    share = min(1.0, dt_s / min(SPREAD_S, flown_s))
    trim.figures[SQUARE] += share * (square - trim.figures[SQUARE])
