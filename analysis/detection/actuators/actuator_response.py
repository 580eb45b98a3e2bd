"""Tracks the response of actuators through the samples of a block, compiled.

The test is suspended on the ground, where the ground reaction hides motor failures. The vehicle
counts as flying once it is 3 m above its first fix or faster than 3 m/s, until it rests near its
first height again. While it is low and slow in between, a leg may touch the ground, so the test is
suspended too; a vehicle with wings that began at rest may roll on the ground at any speed. An
impact while an actuator is isolated is a crash: no sensor is tested after it until the next flight.
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
    track_imbalance,
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
    FIX_3D,
    FIX_TYPE,
    IMU,
    OUTPUTS,
    Indices,
    Stamps,
)
from analysis.samples.sample import IMU_VALUE_LIMIT, Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3

# 3 s of flight before the first test, chosen: the model's constants have settled
LEARNED_BINS = 30
ROTOR_COUNT = 4  # a controller has four demands, so more rotors' effects are not separable
NONLINEAR_SHARE = 0.02  # nonlinearity of a learned effect, chosen
MOST_OUTLIER_BINS = 30  # 3 s; a longer run of outliers is changed noise or no actuator's fault
NOMINAL_BINS = 10  # without a hypothesis until learning resumes: 1 s
# bins in a row that confirm one hypothesis, or two that are not separable; chosen: 0.3 s, 1.2 s
SINGLE_BINS, PAIR_BINS = 3, 12
# A smaller deficit may be a gust; no gust lasts 0.8 s (benchmarks/actuator_watch.py).
SLIGHT_DEFICIT, SLIGHT_BINS = 0.15, 8
REPEAT_ISOLATED_BINS, REPEAT_NOMINAL_BINS = 5, 10  # bins between two results
FLYING_HEIGHT_M, FLYING_SPEED_MPS, REST_SPEED_MPS = 3.0, 3.0, 0.5
BY_FIRST_FIX = -1.0  # the first fix decides
ALT, VELOCITY = 2, 3  # columns of a fix
GAP_US = 500_000  # without an IMU sample the motion begins anew
# Deviation of a command's lag behind the IMU that suspends the test (1.5 motor lags), for how many
# bins, and the weight of a command in the mean lag (50 commands)
LATE_US, IRREGULAR_BINS, LAG_SHARE = 60_000, 10, 0.02
SPARSE_COMMAND_US = 60_000  # longer intervals hide what motors (lag 40 ms) do in between
LAG_US, INTERVAL_US, NEWEST_US = range(3)  # of the commands' `rhythm`
MOST_COMMAND = 100.0  # no output exceeds 1; larger values come from corrupted logs
IMPACT_MPS2 = 100.0  # 10 g: more than any manoeuvre

# Of `counts`: whether it flies, outlier bins in a row, bins without a hypothesis, bins in a row
# with this hypothesis, bins since the last result; the hypothesis and the isolated (two each)
FLYING, OUTLIER_RUN, NOMINAL_RUN, HYPOTHESIS_RUN, SINCE_RESULT = range(5)
HYPOTHESIS, ISOLATED = 5, 7
# Time of the crash; source of the commands, 0 for none yet; bins left to skip; doubtful bins
CRASH_US, USED_SOURCE, IRREGULAR_LEFT, DOUBTFUL_RUN, COUNTS = 9, 10, 11, 12, 13
NEVER_US = 1 << 62
NO_STATISTIC = -1.0
# r above which learning pauses, below LEAST_EXPLAINED, and for how many bins at most; chosen
DOUBT_STATISTIC, MOST_DOUBTFUL_BINS = 12.0, 200


class ActuatorResponse(NamedTuple):
    """The state of all actuators; `track_actuators` changes it in place.

    `outputs` are monitored for being switched off; `mix` (COMMANDS, COMMANDS) converts them to
    commands; `disturbance` (AXES, AXES) is the covariance of gusts and model error. `start` (2,):
    height of the first fix, and the speed below which the vehicle may be on the ground near that
    height (or `BY_FIRST_FIX`). `rhythm` (3,) of commands in us: mean lag behind the IMU, mean
    interval (NaN before the first), newest stamp.
    """

    bins: MotionBins
    model: MotionModel
    outputs: OutputStates
    mix: Vector
    disturbance: Vector
    counts: NDArray[np.int64]
    start: Vector
    rhythm: Vector
    trim: MotorTrim
    regression: ResponseRegression


class ActuatorVerdicts(NamedTuple):
    """Verdicts: `rows` (k, 4): row, stamp, two isolated actuators; `values` (k, 3): statistic,
    deficit, and the lost share of the command, which replaces the deficit. The first two are
    `NO_STATISTIC` for an output that is switched off. `filled` (1,) counts them."""

    rows: NDArray[np.int64]
    values: Vector
    filled: NDArray[np.int64]


@compiled
def track_actuators(
    kind: Indices, t_us: Stamps, values: Vector, state: ActuatorResponse, verdicts: ActuatorVerdicts
) -> None:
    """Process the samples of a block, kind (n,), t_us (n,), values (n, w), in order."""
    for row in range(len(kind)):
        if kind[row] == COMMAND:
            _take_command(row, t_us[row], values[row], state, verdicts)
        # Ignored before the first command, or results would depend on how the stream is cut.
        elif not state.counts[USED_SOURCE]:
            continue
        elif kind[row] == FIX:
            _update_flying(values[row], state)
        elif kind[row] == AIRSPEED and 0.0 < values[row, 0] < np.inf:
            air = state.bins.air
            air[VALUE_MPS] = np.sqrt(2.0 * values[row, 0] / SEA_LEVEL_DENSITY_KGPM3)
            air[UNTIL_US] = t_us[row] + AIR_LASTS_US
        # Only the first IMU is used.
        elif kind[row] == IMU and values[row, 6] == 0.0 and state.counts[FLYING]:
            if not (np.abs(values[row, :6]) <= IMU_VALUE_LIMIT).all():  # false for NaN
                continue
            # A link that swaps frames mixes commands and motion of different times.
            if 0 < state.bins.clock[SAMPLE_US] - t_us[row] < GAP_US:
                state.counts[IRREGULAR_LEFT] = IRREGULAR_BINS
                continue
            if abs(t_us[row] - state.bins.clock[SAMPLE_US]) > GAP_US:
                _begin_flight(state)
            _detect_crash(values[row, 3:6], t_us[row], state.counts)
            if not add_imu_sample(state.bins, t_us[row], values[row, :6]):
                continue
            if state.counts[IRREGULAR_LEFT] > 0:
                state.counts[IRREGULAR_LEFT] -= 1
                continue
            found = _test_bin(state)
            if _is_observable(state) and _update_isolation(found, state.counts):
                who = state.counts[ISOLATED], state.counts[ISOLATED + 1]
                _add_verdict(
                    row, t_us[row], who, (found.statistic, found.deficit, found.share), verdicts
                )


@compiled
def _take_command(
    row: int, t_us: int, outputs: Vector, state: ActuatorResponse, verdicts: ActuatorVerdicts
) -> None:
    """Use commands of the first source, or of the one that the effects are for."""
    counts = state.counts
    source = int(outputs[COMMAND_SOURCE])
    if not counts[USED_SOURCE] and (source == CONTROLS or state.model.counts[UNKNOWN]):
        counts[USED_SOURCE] = source
    if source != counts[USED_SOURCE] or not (np.abs(outputs[:COMMANDS]) <= MOST_COMMAND).all():
        return
    _compare_lag(float(state.bins.clock[SAMPLE_US] - t_us), state)
    _compare_interval(t_us, state.rhythm)
    state.bins.commands[0] = state.mix @ outputs[:COMMANDS]
    if source == OUTPUTS:
        off = track_outputs(outputs[:COMMANDS], t_us, counts[FLYING] == 1, state.outputs)
        if off >= 0:
            _add_verdict(
                row, t_us, (NO_HYPOTHESIS, off), (NO_STATISTIC, NO_STATISTIC, 0.0), verdicts
            )
        elif state.model.counts[UNKNOWN]:
            _test_imbalance(row, t_us, outputs, state, verdicts)


@compiled
def _test_imbalance(
    row: int, t_us: int, outputs: Vector, state: ActuatorResponse, verdicts: ActuatorVerdicts
) -> None:
    """Compare sparse outputs with each other, as they cannot be compared with the motion."""
    if not state.counts[FLYING]:
        reset_imbalance(state.trim)
        return
    dt_s = state.rhythm[INTERVAL_US] * 1e-6
    off = state.outputs.reported.any() or state.outputs.parked.any()
    if not dt_s >= SPARSE_COMMAND_US * 1e-6 or off or state.counts[IRREGULAR_LEFT] > 0:
        return
    who = track_imbalance(outputs[:COMMANDS], dt_s, state.outputs, state.trim)
    if who != NO_RESULT:
        values = state.trim.values[SCORE], state.trim.values[RAISED], 0.0
        _add_verdict(
            row, t_us, (NO_HYPOTHESIS, NO_HYPOTHESIS if who == BALANCED else who), values, verdicts
        )


@compiled
def _compare_lag(lag_us: float, state: ActuatorResponse) -> None:
    """Suspend the test if a command's lag behind the IMU differs from the mean lag."""
    if not state.counts[FLYING] or abs(lag_us) > GAP_US:
        return
    if np.isnan(state.rhythm[LAG_US]):
        state.rhythm[LAG_US] = lag_us
    elif abs(lag_us - state.rhythm[LAG_US]) > LATE_US:
        state.counts[IRREGULAR_LEFT] = IRREGULAR_BINS
    state.rhythm[LAG_US] += LAG_SHARE * (lag_us - state.rhythm[LAG_US])


@compiled
def _compare_interval(t_us: int, rhythm: Vector) -> None:
    """Update the mean interval of commands."""
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
    values: tuple[float, float, float],
    verdicts: ActuatorVerdicts,
) -> None:
    """Add a verdict: two isolated actuators; statistic, deficit and lost share."""
    at = verdicts.filled[0]
    verdicts.rows[at, 0], verdicts.rows[at, 1] = row, t_us
    verdicts.rows[at, 2], verdicts.rows[at, 3] = who
    figure = verdicts.values[at]
    figure[0], figure[1], figure[2] = values
    verdicts.filled[0] += 1


@compiled
def _detect_crash(force: Vector, t_us: int, counts: NDArray[np.int64]) -> None:
    """Detect a crash from a specific force (3,)."""
    square = force[0] ** 2 + force[1] ** 2 + force[2] ** 2
    isolated = counts[ISOLATED + 1] != NO_HYPOTHESIS
    if square > IMPACT_MPS2**2 and isolated and counts[CRASH_US] == NEVER_US:
        counts[CRASH_US] = t_us


@compiled
def _begin_flight(state: ActuatorResponse) -> None:
    """Reset the parts of the state that a take-off or a gap invalidates."""
    state.bins.clock[HAS_PREVIOUS] = 0
    state.model.counts[:UNKNOWN] = 0
    state.model.mean[:] = state.model.nonlinearity[:] = 0.0
    reset_regression(state.regression)


@compiled
def _update_flying(fix: Vector, state: ActuatorResponse) -> None:
    """Detect take-off and landing from a receiver's fix."""
    if fix[FIX_TYPE] < FIX_3D:
        return
    speed = 0.0
    for i in range(3):
        if not np.isnan(fix[VELOCITY + i]):
            speed += fix[VELOCITY + i] ** 2
    speed = np.sqrt(speed)
    if np.isnan(state.start[0]):
        state.start[0] = fix[ALT]
        if state.start[1] == BY_FIRST_FIX:
            state.start[1] = np.inf if speed < REST_SPEED_MPS else FLYING_SPEED_MPS
    up = abs(fix[ALT] - state.start[0]) > FLYING_HEIGHT_M
    if not state.counts[FLYING] and (up or speed > FLYING_SPEED_MPS):
        state.counts[FLYING], state.counts[CRASH_US] = 1, NEVER_US
        _begin_flight(state)
    elif state.counts[FLYING] and not up and speed < REST_SPEED_MPS:
        state.counts[FLYING] = 0
        state.counts[ISOLATED : ISOLATED + 2] = NO_HYPOTHESIS
    elif not up and speed < state.start[1]:
        state.counts[IRREGULAR_LEFT] = IRREGULAR_BINS


@compiled
def _is_observable(state: ActuatorResponse) -> bool:
    """Whether the actuators' effects are known; with a motor off the vehicle is another."""
    model, outputs = state.model, state.outputs
    known = not model.counts[UNKNOWN] or (
        state.rhythm[INTERVAL_US] < SPARSE_COMMAND_US
        and count_known_rotors(model.theta, model.p) == ROTOR_COUNT
    )
    return known and not outputs.reported.any() and not outputs.parked.any()


@compiled
def _test_bin(state: ActuatorResponse) -> ActuatorHypothesis:
    """Compare a full bin with the model, find a hypothesis, and learn if there is none."""
    bins, model, counts = state.bins, state.model, state.counts
    compare_motion(bins.terms, bins.motion, model)
    covariance = model.spread + state.disturbance
    for axis in range(AXES):
        covariance[axis, axis] += model.doubt[axis] + model.nonlinearity[axis] ** 2
        if model.counts[UNKNOWN]:
            strongest = np.abs(model.theta[axis, OUTPUT:RATE]).max()
            covariance[axis, axis] += (NONLINEAR_SHARE * strongest) ** 2
    found = find_hypothesis(
        model.mean, covariance, model.theta, model.p, model.counts[UNKNOWN] == 1
    )
    learned = model.counts[BINS] > LEARNED_BINS and _is_observable(state)
    if not learned:
        found = ActuatorHypothesis(found.statistic, NO_HYPOTHESIS, NO_HYPOTHESIS, 0.0, 0.0)
    statistic = found.statistic
    counts[OUTLIER_RUN] = counts[OUTLIER_RUN] + 1 if statistic >= OUTLIER_STATISTIC else 0
    if learned:
        _update_response(state)
        found = _with_regression(found, state.regression)
    counts[NOMINAL_RUN] = counts[NOMINAL_RUN] + 1 if found.first == NO_HYPOTHESIS else 0
    learn_motion(bins.terms, bins.motion, model, statistic, learned and _suspends_learning(state))
    return found


@compiled
def _suspends_learning(state: ActuatorResponse) -> bool:
    """Whether the model must not learn now because an actuator may be faulty."""
    counts = state.counts
    if state.regression.hypotheses[0] == LOAD:
        return False
    suspected = counts[NOMINAL_RUN] < NOMINAL_BINS or counts[ISOLATED + 1] != NO_HYPOTHESIS
    doubtful = (
        0 < counts[OUTLIER_RUN] < MOST_OUTLIER_BINS or 0 < counts[DOUBTFUL_RUN] < MOST_DOUBTFUL_BINS
    )
    suspended: bool = suspected or doubtful
    return suspended


@compiled
def _update_response(state: ActuatorResponse) -> None:
    """Update the regression over seconds."""
    regression, counts = state.regression, state.counts
    known = regression.hypotheses[0]
    if counts[OUTLIER_RUN] == 1 and not 0 <= known < COMMANDS:  # a fault may have begun
        reset_regression(regression)
    counts[DOUBTFUL_RUN] = (
        counts[DOUBTFUL_RUN] + 1 if regression.explained.max() > DOUBT_STATISTIC else 0
    )
    update_regression(state.bins.terms, state.model, _suspends_learning(state), regression)
    if regression.hypotheses[0] == LOAD and known != LOAD:
        # The shifted load is a new moment, which the model has to learn.
        state.model.p[PITCH, FORCE + 1, FORCE + 1] += regression.shares[LOAD] ** 2


@compiled
def _with_regression(
    found: ActuatorHypothesis, regression: ResponseRegression
) -> ActuatorHypothesis:
    """The hypothesis, replaced by the regression's where that is more specific."""
    first, second = regression.hypotheses
    slight = found.first == NO_HYPOTHESIS or found.second == LOAD or found.first == LOAD
    if first >= COMMANDS and slight:
        return ActuatorHypothesis(0.0, NO_HYPOTHESIS, NO_HYPOTHESIS, 0.0, 0.0)
    if NO_HYPOTHESIS < first < COMMANDS and (slight or found.second != NO_HYPOTHESIS):
        explained = max(found.statistic, regression.explained[first])
        return ActuatorHypothesis(explained, first, second, 0.0, regression.shares[first])
    return found


@compiled
def _update_isolation(found: ActuatorHypothesis, counts: NDArray[np.int64]) -> bool:
    """Whether a result is due; the isolated actuators are in `counts`."""
    pair = min(found.first, found.second), max(found.first, found.second)
    same = pair[0] == counts[HYPOTHESIS] and pair[1] == counts[HYPOTHESIS + 1]
    counts[HYPOTHESIS_RUN] = counts[HYPOTHESIS_RUN] + 1 if same else 1
    # A single hypothesis is second: NO_HYPOTHESIS is the smallest.
    counts[HYPOTHESIS], counts[HYPOTHESIS + 1] = pair
    isolated = counts[ISOLATED + 1]
    counts[SINCE_RESULT] += 1
    # The fault changes the flight, so the first isolation is the most reliable and is kept.
    most = SINGLE_BINS if pair[0] == NO_HYPOTHESIS else PAIR_BINS
    if found.share == 0.0 and abs(found.deficit) < SLIGHT_DEFICIT:
        most = max(most, SLIGHT_BINS)
    confirmed = found.first != NO_HYPOTHESIS and counts[HYPOTHESIS_RUN] >= most
    if confirmed and (isolated == NO_HYPOTHESIS or _narrows_pair(pair, counts)):
        counts[ISOLATED], counts[ISOLATED + 1] = pair
        counts[SINCE_RESULT] = REPEAT_ISOLATED_BINS
    elif isolated != NO_HYPOTHESIS and found.statistic < OUTLIER_STATISTIC:
        counts[ISOLATED], counts[ISOLATED + 1] = NO_HYPOTHESIS, NO_HYPOTHESIS
        counts[SINCE_RESULT] = REPEAT_NOMINAL_BINS
    pause = REPEAT_NOMINAL_BINS if counts[ISOLATED + 1] == NO_HYPOTHESIS else REPEAT_ISOLATED_BINS
    if counts[SINCE_RESULT] < pause:
        return False
    counts[SINCE_RESULT] = 0
    return True


@compiled
def _narrows_pair(pair: tuple[int, int], counts: NDArray[np.int64]) -> bool:
    """Whether `pair` is a single hypothesis and one of the two isolated actuators."""
    first, second = counts[ISOLATED], counts[ISOLATED + 1]
    one: bool = (
        pair[0] == NO_HYPOTHESIS
        and first != NO_HYPOTHESIS
        and (pair[1] == first or pair[1] == second)
    )
    return one
