"""The samples of a block in a row, compiled: cells, what remains of them, and who is to blame.

Nothing is judged on the ground, which carries what no motor does: a vehicle flies from when it is
3 m above its first fix, or faster than 3 m/s, until it stands still near the first height again. In
between, low and slow, it may already touch the ground with a leg, and nothing is judged either; one
with wings that began at rest may roll there at any speed.
A blow while an actuator is to blame is a crash: from then on nothing that a sensor says is judged,
until it flies anew.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.actuators.effects import AXES, COMMANDS, FORCE, OUTPUT, RATE
from analysis.detection.actuators.following import Following, forget, remember
from analysis.detection.actuators.motion_cells import (
    AIR_LASTS_US,
    FOLLOWS,
    SAMPLE_US,
    UNTIL_US,
    VALUE_MPS,
    Cells,
    fill,
)
from analysis.detection.actuators.motion_filter import CELLS, UNKNOWN, Learnt, compare, learn
from analysis.detection.actuators.suspects import (
    LOAD,
    LOUD,
    NOBODY,
    PITCH,
    Suspicion,
    known_rotors,
    suspect,
)
from analysis.detection.actuators.switched_off import Outputs, command
from analysis.detection.actuators.uneven import (
    OBEYS,
    RAISED,
    SCORE,
    SILENT,
    Trim,
    settle,
)
from analysis.detection.actuators.uneven import (
    compare as compare_outputs,
)
from analysis.samples.block import (
    AIRSPEED,
    COMMAND,
    COMMAND_SOURCE,
    CONTROLS,
    FIX,
    FIX_TYPE,
    IMU,
    OUTPUTS,
    Indices,
    Stamps,
)
from analysis.samples.sample import MOST_OF_IMU, Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3

LEARNT = 30  # cells of flight before anybody is suspected
ROTORS = 4  # that a controller moves apart from each other: of more, effects cannot be told
LEARNT_SHARE = 0.02  # of a learnt effect: what is not linear in it
FRESH = 30  # loud cells after which the noise has changed, or nobody here did it
QUIET = 10  # cells without a suspect after which learning goes on
ALONE, ALIKE = 3, 12  # cells in a row that one suspect, or two alike, take to be blamed
SLIGHT, SLIGHT_CELLS = 0.15, 8  # a deficit that a gust may look like, and how long it then takes
AGAIN_BLAMED, AGAIN_SOUND = 5, 10  # cells between two results
FIX_3D = 3
FLIES_M, FLIES_MPS, STANDS_MPS = 3.0, 3.0, 0.5
BY_ITS_START = -1.0
ALT, VELOCITY = 2, 3  # columns of a fix
GAP_US = 500_000  # without a sample of the IMU
# A command that comes so much later or earlier than usual, against the IMU's stamps; the cells that
# are passed over then, or after it was low and slow; and what a command counts in the usual
LATE_US, IRREGULAR_CELLS, LAG_SHARE = 60_000, 10, 0.02
SELDOM_US = 60_000  # between commands: what they were meanwhile is not known, nor what they do
LAG_US, INTERVAL_US, NEWEST_US = range(3)  # of the usual `rhythm` of commands
MOST_COMMAND = 100.0  # of no output: a damaged log has such
BLOW_MPS2 = 100.0  # specific force of no manoeuvre

# Of `counts`: whether it flies, loud cells in a row, cells without a suspect, cells in a row with
# these suspects, cells since the last result; the suspects, and who is blamed (two of each)
FLIES, LOUD_CELLS, QUIET_CELLS, RUN, SINCE, SUSPECT, BLAMED = 0, 1, 2, 3, 4, 5, 7
# When it crashed; whose commands came, 0 for none yet; cells that are passed over yet; how many
CRASH_US, COMMANDED, IRREGULAR, DOUBTFUL, COUNTS = 9, 10, 11, 12, 13
NEVER_US = 1 << 62
OFF = -1.0  # of no statistic
DOUBTS, PATIENCE = 12.0, 200  # r from which learning waits, and for how many cells


class Obedience(NamedTuple):
    """All that is kept; `follow` changes it in place.

    `outputs` are watched for being switched off; `mix` (COMMANDS, COMMANDS) makes commands of them;
    `disturbance` (AXES, AXES) is of gusts and the model; `start` (2,) is the first fix's height and
    below which speed the ground may carry it near that (`BY_ITS_START`: the first fix decides);
    `rhythm` (3,) of commands in us: how far they usually lie behind the IMU and apart, NaN before
    the first, and the newest stamp.
    """

    cells: Cells
    learnt: Learnt
    outputs: Outputs
    mix: Vector
    disturbance: Vector
    counts: NDArray[np.int64]
    start: Vector
    rhythm: Vector
    trim: Trim
    following: Following


class Verdicts(NamedTuple):
    """Rows (k, 4): row, stamp, two who are blamed; statistic, deficit, and the share of its command
    that is lost, where that is told in the deficit's place (k, 3); the first two are `OFF` for an
    output that is switched off; `filled` (1,)."""

    rows: NDArray[np.int64]
    figures: Vector
    filled: NDArray[np.int64]


@compiled
def follow(
    kind: Indices, t_us: Stamps, values: Vector, kept: Obedience, verdicts: Verdicts
) -> None:
    """Look at the samples of a block, kind (n,), t_us (n,), values (n, w), one after the other."""
    for row in range(len(kind)):
        if kind[row] == COMMAND:
            _command(row, t_us[row], values[row], kept, verdicts)
        # Whatever came before the first command would be seen in a long block only.
        elif not kept.counts[COMMANDED]:
            continue
        elif kind[row] == FIX:
            _fly(values[row], kept)
        elif kind[row] == AIRSPEED and 0.0 < values[row, 0] < np.inf:
            air = kept.cells.air
            air[VALUE_MPS] = np.sqrt(2.0 * values[row, 0] / SEA_LEVEL_DENSITY_KGPM3)
            air[UNTIL_US] = t_us[row] + AIR_LASTS_US
        # Of the first IMU alone.
        elif kind[row] == IMU and values[row, 6] == 0.0 and kept.counts[FLIES]:
            if not (np.abs(values[row, :6]) <= MOST_OF_IMU).all():  # which NaN is not
                continue
            # A link that delays and swaps frames tells commands and motion of different times.
            if 0 < kept.cells.clock[SAMPLE_US] - t_us[row] < GAP_US:
                kept.counts[IRREGULAR] = IRREGULAR_CELLS
                continue
            if abs(t_us[row] - kept.cells.clock[SAMPLE_US]) > GAP_US:
                _begin(kept)
            _feel(values[row, 3:6], t_us[row], kept.counts)
            if not fill(kept.cells, t_us[row], values[row, :6]):
                continue
            if kept.counts[IRREGULAR] > 0:
                kept.counts[IRREGULAR] -= 1
                continue
            found = _judge(kept)
            if _can_tell(kept) and _blame(found, kept.counts):
                who = kept.counts[BLAMED], kept.counts[BLAMED + 1]
                _tell(row, t_us[row], who, (found.statistic, found.deficit, found.share), verdicts)


@compiled
def _command(row: int, t_us: int, outputs: Vector, kept: Obedience, verdicts: Verdicts) -> None:
    """Take commands of the source that came first, or that the vehicle is known by."""
    counts = kept.counts
    source = int(outputs[COMMAND_SOURCE])
    if not counts[COMMANDED] and (source == CONTROLS or kept.learnt.counts[UNKNOWN]):
        counts[COMMANDED] = source
    if source != counts[COMMANDED] or not (np.abs(outputs[:COMMANDS]) <= MOST_COMMAND).all():
        return
    _compare_lag(float(kept.cells.clock[SAMPLE_US] - t_us), kept)
    _compare_interval(t_us, kept.rhythm)
    kept.cells.commands[0] = kept.mix @ outputs[:COMMANDS]
    if source == OUTPUTS:
        off = command(outputs[:COMMANDS], t_us, counts[FLIES] == 1, kept.outputs)
        if off >= 0:
            _tell(row, t_us, (NOBODY, off), (OFF, OFF, 0.0), verdicts)
        elif kept.learnt.counts[UNKNOWN]:
            _compare_outputs(row, t_us, outputs, kept, verdicts)


@compiled
def _compare_outputs(
    row: int, t_us: int, outputs: Vector, kept: Obedience, verdicts: Verdicts
) -> None:
    """Hold outputs that come seldom against each other, as no motion can be held against them."""
    if not kept.counts[FLIES]:
        settle(kept.trim)
        return
    dt_s = kept.rhythm[INTERVAL_US] * 1e-6
    off = kept.outputs.gone.any() or kept.outputs.parked.any()
    if not dt_s >= SELDOM_US * 1e-6 or off or kept.counts[IRREGULAR] > 0:
        return
    who = compare_outputs(outputs[:COMMANDS], dt_s, kept.outputs, kept.trim)
    if who != SILENT:
        figures = kept.trim.figures[SCORE], kept.trim.figures[RAISED], 0.0
        _tell(row, t_us, (NOBODY, NOBODY if who == OBEYS else who), figures, verdicts)


@compiled
def _compare_lag(lag_us: float, kept: Obedience) -> None:
    """Hold how far a command lies behind the IMU against what is usual."""
    if not kept.counts[FLIES] or abs(lag_us) > GAP_US:
        return
    if np.isnan(kept.rhythm[LAG_US]):
        kept.rhythm[LAG_US] = lag_us
    elif abs(lag_us - kept.rhythm[LAG_US]) > LATE_US:
        kept.counts[IRREGULAR] = IRREGULAR_CELLS
    kept.rhythm[LAG_US] += LAG_SHARE * (lag_us - kept.rhythm[LAG_US])


@compiled
def _compare_interval(t_us: int, rhythm: Vector) -> None:
    """Learn how far commands lie apart."""
    apart_us = t_us - rhythm[NEWEST_US]
    rhythm[NEWEST_US] = t_us
    if 0.0 < apart_us < GAP_US:
        if np.isnan(rhythm[INTERVAL_US]):
            rhythm[INTERVAL_US] = apart_us
        rhythm[INTERVAL_US] += LAG_SHARE * (apart_us - rhythm[INTERVAL_US])


@compiled
def _tell(
    row: int,
    t_us: int,
    who: tuple[int, int],
    figures: tuple[float, float, float],
    verdicts: Verdicts,
) -> None:
    """Add a verdict: two who are blamed; statistic, deficit, and share that is lost."""
    at = verdicts.filled[0]
    verdicts.rows[at, 0], verdicts.rows[at, 1] = row, t_us
    verdicts.rows[at, 2], verdicts.rows[at, 3] = who
    figure = verdicts.figures[at]
    figure[0], figure[1], figure[2] = figures
    verdicts.filled[0] += 1


@compiled
def _feel(force: Vector, t_us: int, counts: NDArray[np.int64]) -> None:
    """Look for a crash in a specific force (3,)."""
    square = force[0] ** 2 + force[1] ** 2 + force[2] ** 2
    blamed = counts[BLAMED + 1] != NOBODY
    if square > BLOW_MPS2**2 and blamed and counts[CRASH_US] == NEVER_US:
        counts[CRASH_US] = t_us


@compiled
def _begin(kept: Obedience) -> None:
    """A flight begins, or goes on after a gap: what it was like before says little."""
    kept.cells.clock[FOLLOWS] = 0
    kept.learnt.counts[:UNKNOWN] = 0
    kept.learnt.mean[:] = kept.learnt.bent[:] = 0.0
    forget(kept.following)


@compiled
def _fly(fix: Vector, kept: Obedience) -> None:
    """Take off and land, by a receiver's fix."""
    if fix[FIX_TYPE] < FIX_3D:
        return
    speed = 0.0
    for i in range(3):
        if not np.isnan(fix[VELOCITY + i]):
            speed += fix[VELOCITY + i] ** 2
    speed = np.sqrt(speed)
    if np.isnan(kept.start[0]):
        kept.start[0] = fix[ALT]
        if kept.start[1] == BY_ITS_START:
            kept.start[1] = np.inf if speed < STANDS_MPS else FLIES_MPS
    up = abs(fix[ALT] - kept.start[0]) > FLIES_M
    if not kept.counts[FLIES] and (up or speed > FLIES_MPS):
        kept.counts[FLIES], kept.counts[CRASH_US] = 1, NEVER_US
        _begin(kept)
    elif kept.counts[FLIES] and not up and speed < STANDS_MPS:
        kept.counts[FLIES] = 0
        kept.counts[BLAMED : BLAMED + 2] = NOBODY
    elif not up and speed < kept.start[1]:
        kept.counts[IRREGULAR] = IRREGULAR_CELLS


@compiled
def _can_tell(kept: Obedience) -> bool:
    """Whether the effects of the actuators are known; with a motor off the vehicle is another."""
    learnt, outputs = kept.learnt, kept.outputs
    known = not learnt.counts[UNKNOWN] or (
        kept.rhythm[INTERVAL_US] < SELDOM_US and known_rotors(learnt.theta, learnt.p) == ROTORS
    )
    return known and not outputs.gone.any() and not outputs.parked.any()


@compiled
def _judge(kept: Obedience) -> Suspicion:
    """Compare a full cell with the model, look for suspects, and learn where there is none."""
    cells, learnt, counts = kept.cells, kept.learnt, kept.counts
    compare(cells.terms, cells.motion, learnt)
    usual = learnt.spread + kept.disturbance
    for axis in range(AXES):
        usual[axis, axis] += learnt.doubt[axis] + learnt.bent[axis] ** 2
        if learnt.counts[UNKNOWN]:
            strongest = np.abs(learnt.theta[axis, OUTPUT:RATE]).max()
            usual[axis, axis] += (LEARNT_SHARE * strongest) ** 2
    found = suspect(learnt.mean, usual, learnt.theta, learnt.p, learnt.counts[UNKNOWN] == 1)
    begun = learnt.counts[CELLS] > LEARNT and _can_tell(kept)
    if not begun:
        found = Suspicion(found.statistic, NOBODY, NOBODY, 0.0, 0.0)
    statistic = found.statistic
    counts[LOUD_CELLS] = counts[LOUD_CELLS] + 1 if statistic >= LOUD else 0
    if begun:
        _follow(kept)
        found = _patient(found, kept.following)
    counts[QUIET_CELLS] = counts[QUIET_CELLS] + 1 if found.first == NOBODY else 0
    learn(cells.terms, cells.motion, learnt, statistic, begun and _waits(kept))
    return found


@compiled
def _waits(kept: Obedience) -> bool:
    """Whether nothing is learnt now, as somebody may be at fault."""
    counts = kept.counts
    if kept.following.who[0] == LOAD:
        return False
    suspected = counts[QUIET_CELLS] < QUIET or counts[BLAMED + 1] != NOBODY
    doubtful = 0 < counts[LOUD_CELLS] < FRESH or 0 < counts[DOUBTFUL] < PATIENCE
    waits: bool = suspected or doubtful
    return waits


@compiled
def _follow(kept: Obedience) -> None:
    """Ask over seconds whether the commands are followed."""
    following, counts = kept.following, kept.counts
    known = following.who[0]
    if counts[LOUD_CELLS] == 1 and not 0 <= known < COMMANDS:  # something may have begun
        forget(following)
    counts[DOUBTFUL] = counts[DOUBTFUL] + 1 if following.explained.max() > DOUBTS else 0
    remember(kept.cells.terms, kept.learnt, _waits(kept), following)
    if following.who[0] == LOAD and known != LOAD:
        # What it turns is another model's, which is to be learnt.
        kept.learnt.p[PITCH, FORCE + 1, FORCE + 1] += following.shares[LOAD] ** 2


@compiled
def _patient(found: Suspicion, following: Following) -> Suspicion:
    """What is found, with what seconds told."""
    first, second = following.who
    slight = found.first == NOBODY or found.second == LOAD or found.first == LOAD
    if first >= COMMANDS and slight:
        return Suspicion(0.0, NOBODY, NOBODY, 0.0, 0.0)
    if NOBODY < first < COMMANDS and (slight or found.second != NOBODY):
        explained = max(found.statistic, following.explained[first])
        return Suspicion(explained, first, second, 0.0, following.shares[first])
    return found


@compiled
def _blame(found: Suspicion, counts: NDArray[np.int64]) -> bool:
    """Whether there is something to say; who is blamed stands in `counts`."""
    pair = min(found.first, found.second), max(found.first, found.second)
    same = pair[0] == counts[SUSPECT] and pair[1] == counts[SUSPECT + 1]
    counts[RUN] = counts[RUN] + 1 if same else 1
    counts[SUSPECT], counts[SUSPECT + 1] = pair  # one alone stands second: NOBODY is the least
    blamed = counts[BLAMED + 1]
    counts[SINCE] += 1
    # A fault changes the flight, so that what comes first tells most: who is blamed stays blamed.
    most = ALONE if pair[0] == NOBODY else ALIKE
    if found.share == 0.0 and abs(found.deficit) < SLIGHT:
        most = max(most, SLIGHT_CELLS)
    told = found.first != NOBODY and counts[RUN] >= most
    if told and (blamed == NOBODY or _is_one(pair, counts)):
        counts[BLAMED], counts[BLAMED + 1] = pair
        counts[SINCE] = AGAIN_BLAMED
    elif blamed != NOBODY and found.statistic < LOUD:
        counts[BLAMED], counts[BLAMED + 1] = NOBODY, NOBODY
        counts[SINCE] = AGAIN_SOUND
    pause = AGAIN_SOUND if counts[BLAMED + 1] == NOBODY else AGAIN_BLAMED
    if counts[SINCE] < pause:
        return False
    counts[SINCE] = 0
    return True


@compiled
def _is_one(pair: tuple[int, int], counts: NDArray[np.int64]) -> bool:
    """Whether who is suspected now, alone, is one of two who are blamed."""
    first, second = counts[BLAMED], counts[BLAMED + 1]
    one: bool = pair[0] == NOBODY and first != NOBODY and (pair[1] == first or pair[1] == second)
    return one
