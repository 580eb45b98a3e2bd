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

from analysis.detection.actuators.actuator_hypotheses import (
    LOAD,
    NO_HYPOTHESIS,
    OUTLIER_STATISTIC,
    PITCH,
    ActuatorHypothesis,
    count_known_rotors,
    find_hypothesis,
)
from analysis.detection.actuators.effects import AXES, COMMANDS, FORCE, OUTPUT, RATE
from analysis.detection.actuators.motion_bins import (
    AIR_LASTS_US,
    HAS_PREVIOUS,
    SAMPLE_US,
    UNTIL_US,
    VALUE_MPS,
    MotionBins,
    add_imu_sample,
)
from analysis.detection.actuators.motion_filter import (
    BINS,
    UNKNOWN,
    MotionModel,
    compare_motion,
    learn_motion,
)
from analysis.detection.actuators.motor_imbalance import (
    BALANCED,
    NO_RESULT,
    RAISED,
    SCORE,
    MotorTrim,
    reset_imbalance,
)
from analysis.detection.actuators.motor_imbalance import (
    track_imbalance as compare_outputs,
)
from analysis.detection.actuators.response_regression import (
    ResponseRegression,
    reset_regression,
    update_regression,
)
from analysis.detection.actuators.switched_off import OutputStates, track_outputs
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
from analysis.samples.sample import IMU_VALUE_LIMIT, Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3

LEARNED_BINS = 30  # cells of flight before anybody is suspected
ROTOR_COUNT = 4  # that a controller moves apart from each other: of more, effects cannot be told
NONLINEAR_SHARE = 0.02  # of a learnt effect: what is not linear in it
MOST_OUTLIER_BINS = 30  # loud cells after which the noise has changed, or nobody here did it
NOMINAL_BINS = 10  # cells without a suspect after which learning goes on
SINGLE_BINS, PAIR_BINS = 3, 12  # cells in a row that one suspect, or two alike, take to be blamed
SLIGHT_DEFICIT, SLIGHT_BINS = (
    0.15,
    8,
)  # a deficit that a gust may look like, and how long it then takes
REPEAT_ISOLATED_BINS, REPEAT_NOMINAL_BINS = 5, 10  # cells between two results
FIX_3D = 3
FLYING_HEIGHT_M, FLYING_SPEED_MPS, REST_SPEED_MPS = 3.0, 3.0, 0.5
BY_FIRST_FIX = -1.0
ALT, VELOCITY = 2, 3  # columns of a fix
GAP_US = 500_000  # without a sample of the IMU
# A command that comes so much later or earlier than usual, against the IMU's stamps; the cells that
# are passed over then, or after it was low and slow; and what a command counts in the usual
LATE_US, IRREGULAR_BINS, LAG_SHARE = 60_000, 10, 0.02
SPARSE_COMMAND_US = (
    60_000  # between commands: what they were meanwhile is not known, nor what they do
)
LAG_US, INTERVAL_US, NEWEST_US = range(3)  # of the usual `rhythm` of commands
MOST_COMMAND = 100.0  # of no output: a damaged log has such
IMPACT_MPS2 = 100.0  # specific force of no manoeuvre

# Of `counts`: whether it flies, loud cells in a row, cells without a suspect, cells in a row with
# these suspects, cells since the last result; the suspects, and who is blamed (two of each)
FLYING, OUTLIER_RUN, NOMINAL_RUN, HYPOTHESIS_RUN, SINCE_RESULT, HYPOTHESIS, ISOLATED = (
    0,
    1,
    2,
    3,
    4,
    5,
    7,
)
# When it crashed; whose commands came, 0 for none yet; cells that are passed over yet; how many
CRASH_US, USED_SOURCE, IRREGULAR_LEFT, DOUBTFUL_RUN, COUNTS = 9, 10, 11, 12, 13
NEVER_US = 1 << 62
NO_STATISTIC = -1.0  # of no statistic
DOUBT_STATISTIC, MOST_DOUBTFUL_BINS = (
    12.0,
    200,
)  # r from which learning waits, and for how many cells


class ActuatorResponse(NamedTuple):
    """All that is kept; `track_actuators` changes it in place.

    `outputs` are watched for being switched off; `mix` (COMMANDS, COMMANDS) makes commands of them;
    `disturbance` (AXES, AXES) is of gusts and the model; `start` (2,) is the first fix's height and
    below which speed the ground may carry it near that (`BY_FIRST_FIX`: the first fix decides);
    `rhythm` (3,) of commands in us: how far they usually lie behind the IMU and apart, NaN before
    the first, and the newest stamp.
    """

    cells: MotionBins
    learnt: MotionModel
    outputs: OutputStates
    mix: Vector
    disturbance: Vector
    counts: NDArray[np.int64]
    start: Vector
    rhythm: Vector
    trim: MotorTrim
    following: ResponseRegression


class ActuatorVerdicts(NamedTuple):
    """Rows (k, 4): row, stamp, two who are blamed; statistic, deficit, and the share of its command
    that is lost, where that is told in the deficit's place (k, 3); the first two are `NO_STATISTIC`
    for an output that is switched off; `filled` (1,)."""

    rows: NDArray[np.int64]
    figures: Vector
    filled: NDArray[np.int64]


@compiled
def track_actuators(
    kind: Indices, t_us: Stamps, values: Vector, kept: ActuatorResponse, verdicts: ActuatorVerdicts
) -> None:
    """Look at the samples of a block, kind (n,), t_us (n,), values (n, w), one after the other."""
    for row in range(len(kind)):
        if kind[row] == COMMAND:
            _take_command(row, t_us[row], values[row], kept, verdicts)
        # Whatever came before the first command would be seen in a long block only.
        elif not kept.counts[USED_SOURCE]:
            continue
        elif kind[row] == FIX:
            _update_flying(values[row], kept)
        elif kind[row] == AIRSPEED and 0.0 < values[row, 0] < np.inf:
            air = kept.cells.air
            air[VALUE_MPS] = np.sqrt(2.0 * values[row, 0] / SEA_LEVEL_DENSITY_KGPM3)
            air[UNTIL_US] = t_us[row] + AIR_LASTS_US
        # Of the first IMU alone.
        elif kind[row] == IMU and values[row, 6] == 0.0 and kept.counts[FLYING]:
            if not (np.abs(values[row, :6]) <= IMU_VALUE_LIMIT).all():  # which NaN is not
                continue
            # A link that delays and swaps frames tells commands and motion of different times.
            if 0 < kept.cells.clock[SAMPLE_US] - t_us[row] < GAP_US:
                kept.counts[IRREGULAR_LEFT] = IRREGULAR_BINS
                continue
            if abs(t_us[row] - kept.cells.clock[SAMPLE_US]) > GAP_US:
                _begin_flight(kept)
            _detect_crash(values[row, 3:6], t_us[row], kept.counts)
            if not add_imu_sample(kept.cells, t_us[row], values[row, :6]):
                continue
            if kept.counts[IRREGULAR_LEFT] > 0:
                kept.counts[IRREGULAR_LEFT] -= 1
                continue
            found = _test_bin(kept)
            if _is_observable(kept) and _update_isolation(found, kept.counts):
                who = kept.counts[ISOLATED], kept.counts[ISOLATED + 1]
                _add_verdict(
                    row, t_us[row], who, (found.statistic, found.deficit, found.share), verdicts
                )


@compiled
def _take_command(
    row: int, t_us: int, outputs: Vector, kept: ActuatorResponse, verdicts: ActuatorVerdicts
) -> None:
    """Take commands of the source that came first, or that the vehicle is known by."""
    counts = kept.counts
    source = int(outputs[COMMAND_SOURCE])
    if not counts[USED_SOURCE] and (source == CONTROLS or kept.learnt.counts[UNKNOWN]):
        counts[USED_SOURCE] = source
    if source != counts[USED_SOURCE] or not (np.abs(outputs[:COMMANDS]) <= MOST_COMMAND).all():
        return
    _compare_lag(float(kept.cells.clock[SAMPLE_US] - t_us), kept)
    _compare_interval(t_us, kept.rhythm)
    kept.cells.commands[0] = kept.mix @ outputs[:COMMANDS]
    if source == OUTPUTS:
        off = track_outputs(outputs[:COMMANDS], t_us, counts[FLYING] == 1, kept.outputs)
        if off >= 0:
            _add_verdict(
                row, t_us, (NO_HYPOTHESIS, off), (NO_STATISTIC, NO_STATISTIC, 0.0), verdicts
            )
        elif kept.learnt.counts[UNKNOWN]:
            _test_imbalance(row, t_us, outputs, kept, verdicts)


@compiled
def _test_imbalance(
    row: int, t_us: int, outputs: Vector, kept: ActuatorResponse, verdicts: ActuatorVerdicts
) -> None:
    """Hold outputs that come seldom against each other, as no motion can be held against them."""
    if not kept.counts[FLYING]:
        reset_imbalance(kept.trim)
        return
    dt_s = kept.rhythm[INTERVAL_US] * 1e-6
    off = kept.outputs.gone.any() or kept.outputs.parked.any()
    if not dt_s >= SPARSE_COMMAND_US * 1e-6 or off or kept.counts[IRREGULAR_LEFT] > 0:
        return
    who = compare_outputs(outputs[:COMMANDS], dt_s, kept.outputs, kept.trim)
    if who != NO_RESULT:
        figures = kept.trim.figures[SCORE], kept.trim.figures[RAISED], 0.0
        _add_verdict(
            row, t_us, (NO_HYPOTHESIS, NO_HYPOTHESIS if who == BALANCED else who), figures, verdicts
        )


@compiled
def _compare_lag(lag_us: float, kept: ActuatorResponse) -> None:
    """Hold how far a command lies behind the IMU against what is usual."""
    if not kept.counts[FLYING] or abs(lag_us) > GAP_US:
        return
    if np.isnan(kept.rhythm[LAG_US]):
        kept.rhythm[LAG_US] = lag_us
    elif abs(lag_us - kept.rhythm[LAG_US]) > LATE_US:
        kept.counts[IRREGULAR_LEFT] = IRREGULAR_BINS
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
def _add_verdict(
    row: int,
    t_us: int,
    who: tuple[int, int],
    figures: tuple[float, float, float],
    verdicts: ActuatorVerdicts,
) -> None:
    """Add a verdict: two who are blamed; statistic, deficit, and share that is lost."""
    at = verdicts.filled[0]
    verdicts.rows[at, 0], verdicts.rows[at, 1] = row, t_us
    verdicts.rows[at, 2], verdicts.rows[at, 3] = who
    figure = verdicts.figures[at]
    figure[0], figure[1], figure[2] = figures
    verdicts.filled[0] += 1


@compiled
def _detect_crash(force: Vector, t_us: int, counts: NDArray[np.int64]) -> None:
    """Look for a crash in a specific force (3,)."""
    square = force[0] ** 2 + force[1] ** 2 + force[2] ** 2
    blamed = counts[ISOLATED + 1] != NO_HYPOTHESIS
    if square > IMPACT_MPS2**2 and blamed and counts[CRASH_US] == NEVER_US:
        counts[CRASH_US] = t_us


@compiled
def _begin_flight(kept: ActuatorResponse) -> None:
    """A flight begins, or goes on after a gap: what it was like before says little."""
    kept.cells.clock[HAS_PREVIOUS] = 0
    kept.learnt.counts[:UNKNOWN] = 0
    kept.learnt.mean[:] = kept.learnt.bent[:] = 0.0
    reset_regression(kept.following)


@compiled
def _update_flying(fix: Vector, kept: ActuatorResponse) -> None:
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
        if kept.start[1] == BY_FIRST_FIX:
            kept.start[1] = np.inf if speed < REST_SPEED_MPS else FLYING_SPEED_MPS
    up = abs(fix[ALT] - kept.start[0]) > FLYING_HEIGHT_M
    if not kept.counts[FLYING] and (up or speed > FLYING_SPEED_MPS):
        kept.counts[FLYING], kept.counts[CRASH_US] = 1, NEVER_US
        _begin_flight(kept)
    elif kept.counts[FLYING] and not up and speed < REST_SPEED_MPS:
        kept.counts[FLYING] = 0
        kept.counts[ISOLATED : ISOLATED + 2] = NO_HYPOTHESIS
    elif not up and speed < kept.start[1]:
        kept.counts[IRREGULAR_LEFT] = IRREGULAR_BINS


@compiled
def _is_observable(kept: ActuatorResponse) -> bool:
    """Whether the effects of the actuators are known; with a motor off the vehicle is another."""
    learnt, outputs = kept.learnt, kept.outputs
    known = not learnt.counts[UNKNOWN] or (
        kept.rhythm[INTERVAL_US] < SPARSE_COMMAND_US
        and count_known_rotors(learnt.theta, learnt.p) == ROTOR_COUNT
    )
    return known and not outputs.gone.any() and not outputs.parked.any()


@compiled
def _test_bin(kept: ActuatorResponse) -> ActuatorHypothesis:
    """Compare a full cell with the model, look for suspects, and learn where there is none."""
    cells, learnt, counts = kept.cells, kept.learnt, kept.counts
    compare_motion(cells.terms, cells.motion, learnt)
    usual = learnt.spread + kept.disturbance
    for axis in range(AXES):
        usual[axis, axis] += learnt.doubt[axis] + learnt.bent[axis] ** 2
        if learnt.counts[UNKNOWN]:
            strongest = np.abs(learnt.theta[axis, OUTPUT:RATE]).max()
            usual[axis, axis] += (NONLINEAR_SHARE * strongest) ** 2
    found = find_hypothesis(learnt.mean, usual, learnt.theta, learnt.p, learnt.counts[UNKNOWN] == 1)
    begun = learnt.counts[BINS] > LEARNED_BINS and _is_observable(kept)
    if not begun:
        found = ActuatorHypothesis(found.statistic, NO_HYPOTHESIS, NO_HYPOTHESIS, 0.0, 0.0)
    statistic = found.statistic
    counts[OUTLIER_RUN] = counts[OUTLIER_RUN] + 1 if statistic >= OUTLIER_STATISTIC else 0
    if begun:
        _update_response(kept)
        found = _with_regression(found, kept.following)
    counts[NOMINAL_RUN] = counts[NOMINAL_RUN] + 1 if found.first == NO_HYPOTHESIS else 0
    learn_motion(cells.terms, cells.motion, learnt, statistic, begun and _suspends_learning(kept))
    return found


@compiled
def _suspends_learning(kept: ActuatorResponse) -> bool:
    """Whether nothing is learnt now, as somebody may be at fault."""
    counts = kept.counts
    if kept.following.who[0] == LOAD:
        return False
    suspected = counts[NOMINAL_RUN] < NOMINAL_BINS or counts[ISOLATED + 1] != NO_HYPOTHESIS
    doubtful = (
        0 < counts[OUTLIER_RUN] < MOST_OUTLIER_BINS or 0 < counts[DOUBTFUL_RUN] < MOST_DOUBTFUL_BINS
    )
    waits: bool = suspected or doubtful
    return waits


@compiled
def _update_response(kept: ActuatorResponse) -> None:
    """Ask over seconds whether the commands are followed."""
    following, counts = kept.following, kept.counts
    known = following.who[0]
    if counts[OUTLIER_RUN] == 1 and not 0 <= known < COMMANDS:  # something may have begun
        reset_regression(following)
    counts[DOUBTFUL_RUN] = (
        counts[DOUBTFUL_RUN] + 1 if following.explained.max() > DOUBT_STATISTIC else 0
    )
    update_regression(kept.cells.terms, kept.learnt, _suspends_learning(kept), following)
    if following.who[0] == LOAD and known != LOAD:
        # What it turns is another model's, which is to be learnt.
        kept.learnt.p[PITCH, FORCE + 1, FORCE + 1] += following.shares[LOAD] ** 2


@compiled
def _with_regression(
    found: ActuatorHypothesis, following: ResponseRegression
) -> ActuatorHypothesis:
    """What is found, with what seconds told."""
    first, second = following.who
    slight = found.first == NO_HYPOTHESIS or found.second == LOAD or found.first == LOAD
    if first >= COMMANDS and slight:
        return ActuatorHypothesis(0.0, NO_HYPOTHESIS, NO_HYPOTHESIS, 0.0, 0.0)
    if NO_HYPOTHESIS < first < COMMANDS and (slight or found.second != NO_HYPOTHESIS):
        explained = max(found.statistic, following.explained[first])
        return ActuatorHypothesis(explained, first, second, 0.0, following.shares[first])
    return found


@compiled
def _update_isolation(found: ActuatorHypothesis, counts: NDArray[np.int64]) -> bool:
    """Whether there is something to say; who is blamed stands in `counts`."""
    pair = min(found.first, found.second), max(found.first, found.second)
    same = pair[0] == counts[HYPOTHESIS] and pair[1] == counts[HYPOTHESIS + 1]
    counts[HYPOTHESIS_RUN] = counts[HYPOTHESIS_RUN] + 1 if same else 1
    counts[HYPOTHESIS], counts[HYPOTHESIS + 1] = (
        pair  # one alone stands second: NOBODY is the least
    )
    blamed = counts[ISOLATED + 1]
    counts[SINCE_RESULT] += 1
    # A fault changes the flight, so that what comes first tells most: who is blamed stays blamed.
    most = SINGLE_BINS if pair[0] == NO_HYPOTHESIS else PAIR_BINS
    if found.share == 0.0 and abs(found.deficit) < SLIGHT_DEFICIT:
        most = max(most, SLIGHT_BINS)
    told = found.first != NO_HYPOTHESIS and counts[HYPOTHESIS_RUN] >= most
    if told and (blamed == NO_HYPOTHESIS or _narrows_pair(pair, counts)):
        counts[ISOLATED], counts[ISOLATED + 1] = pair
        counts[SINCE_RESULT] = REPEAT_ISOLATED_BINS
    elif blamed != NO_HYPOTHESIS and found.statistic < OUTLIER_STATISTIC:
        counts[ISOLATED], counts[ISOLATED + 1] = NO_HYPOTHESIS, NO_HYPOTHESIS
        counts[SINCE_RESULT] = REPEAT_NOMINAL_BINS
    pause = REPEAT_NOMINAL_BINS if counts[ISOLATED + 1] == NO_HYPOTHESIS else REPEAT_ISOLATED_BINS
    if counts[SINCE_RESULT] < pause:
        return False
    counts[SINCE_RESULT] = 0
    return True


@compiled
def _narrows_pair(pair: tuple[int, int], counts: NDArray[np.int64]) -> bool:
    """Whether who is suspected now, alone, is one of two who are blamed."""
    first, second = counts[ISOLATED], counts[ISOLATED + 1]
    one: bool = (
        pair[0] == NO_HYPOTHESIS
        and first != NO_HYPOTHESIS
        and (pair[1] == first or pair[1] == second)
    )
    return one
