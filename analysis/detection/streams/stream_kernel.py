"""Tracks the samples of every stream, compiled: silence, repetition, timestamps; see
`stream_detector`.

A stream is the samples of one kind, and of one instance for an IMU. Its own past defines what is
usual: the interval of samples, their lateness, how often a value repeats. Clocks that count from
boot and from 1970 are tracked separately.

Nearly every sample is regular. The loop of `track_streams` handles these and uses plain arrays,
since taking an array out of a record costs a reference count; rare cases are in other functions.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.streams.rate_kernel import (
    SINKING_SHARE,
    burst_size,
    count_sample,
    is_rate_known,
    missing_share,
)
from analysis.samples.block import (
    FIX,
    FIX_VELOCITY,
    IMU,
    IMU_ID,
    NEVER_US,
    SOURCES,
    Indices,
    Stamps,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled, inlined

SILENT, REPEATED, FROZEN_TIME, JUMPED_AHEAD, JUMPED_BACK, LATE, SPARSE, BURSTING = range(1, 9)
IMUS = 3
STREAMS = ("imu", "imu", "imu", "mag", "baro", "airspeed", "range", "vision", "gps-position",
           "satellites", "link")  # fmt: skip
LINK = len(STREAMS) - 1
SATELLITES = LINK - 1  # raw ranges have another message's timestamp
# Stream by kind of sample, and how many of its numbers are measured; -1: shows only the time
STREAM_OF = (0, 3, 4, 5, 6, 7, -1, -1, 8, 9, -2, -2, -2, -2)
NUMBERS = (6, 3, 1, 1, 1, 3, 0, 0, 0, 0, 0, 0, 0, 0)
FIX_SOURCE, OWN_SOURCE = 10, SOURCES.index("HIL_GPS")  # a fix's column of its source
FIX_NUMBERS, MOVING_MPS = 5, 1.0  # of a fix: position and level velocity together, while it moves

# samples after which a stream and its values are known, chosen
LEARNED_SAMPLES, LEARNED_VALUES = 20, 200
SHARE = 0.05  # weight of an interval in the usual one: 20 intervals
SILENT_US = 500_000  # shortest silence, chosen
TIME_JUMP_US = 200_000  # smallest jump ahead: an interval at 5 Hz
SEVERAL_CONFIRM_US, SINGLE_CONFIRM_US = 250_000, 1_000_000  # confirm a jump of several, of one
RHYTHM_SAMPLES = 5  # samples after which a stream's interval is roughly known
REGULAR_INTERVALS = 1.5  # usual intervals after which a sample is still regular
INTERVALS = 5.0  # least length of a silence in usual intervals, chosen
PAUSE_FACTOR, FORGOTTEN_US = 1.5, 60e6  # of the longest recent pause: lossy logs and links; memory
LATE_US, SPREAD_FACTOR = 300_000, 8.0  # least lateness, and in its usual spread; chosen
BACK_US = 20_000  # jump back: more than frames that a link swaps
FROZEN_STAMPS = 5  # equal stamps in a row, chosen
# A repetition beyond the sensor's past: factor, samples more, and duration; chosen.
RUN_FACTOR, RUN_MORE, RUN_US = 3, 10, 500_000
STILL_SAMPLES = 20  # a value that has legitimately repeated for 20 samples is exempt from the test
EPOCH_1970_US = 100_000_000_000_000  # larger stamps count from 1970
REPEAT_US = 500_000  # between two results about the same anomaly

# usual values of a stream; the last is the spread of its lateness
INTERVAL, LATENESS, PAUSE, SPREAD = range(4)
# State of a stream; the last: its newest stamp while a jump is unresolved
LAST_US, COUNT, DUE_US, SAME_STAMPS, REPORTED_US = range(5)
CLOCK, RECEIVED_US, ELAPSED_AT_US, WAITED_US = range(5, 9)
# Of each number: when it took its value, repetitions, the most repetitions so far
SINCE_US, RUN, LONGEST = range(3)
# Of a clock: its newest stamp, before when no stream can be silent, an unresolved jump (BY has a
# bit for each stream that made it), and the time elapsed without pauses of all streams
NEWEST_US, NONE_SILENT_US, FROM_US, TO_US, BY, ELAPSED_US = range(6)


class StreamStates(NamedTuple):
    """The state of s streams; `track_streams` changes it in place.

    `counts` (s, 9), `usual` (s, 4): interval, lateness, longest pause and the spread of the
    lateness in us; the newest `values` (s, w), the `runs` (s, w, 3) of each number, `rates` (s, 8),
    `clocks` (2, 6).
    """

    counts: NDArray[np.int64]
    usual: Vector
    values: Vector
    runs: NDArray[np.int64]
    rates: Vector
    clocks: NDArray[np.int64]


class StreamAnomalies(NamedTuple):
    """`rows` (k, 4): row, stamp, stream, anomaly; `amounts` (k,) in s, a share or samples."""

    rows: NDArray[np.int64]
    amounts: Vector
    filled: NDArray[np.int64]


@compiled
def _add_anomaly(
    out: StreamAnomalies, row: int, t_us: int, stream: int, anomaly: int, amount: float
) -> None:
    at = out.filled[0]
    if at < len(out.rows):
        for i, number in enumerate((row, t_us, stream, anomaly)):
            out.rows[at, i] = number
        out.amounts[at] = amount
        out.filled[0] += 1


@inlined
def _limit_us(usual: Vector, stream: int) -> int:
    own_us = max(INTERVALS * usual[stream, INTERVAL], PAUSE_FACTOR * usual[stream, PAUSE])
    limit_us: int = max(SILENT_US, int(own_us))
    return limit_us


@compiled
def _accepts_time(
    states: StreamStates, out: StreamAnomalies, row: int, stream: int, clock: int, t_us: int
) -> bool:
    """Whether a sample's time is accepted; a time that jumps ahead has to be confirmed.

    If time continues from there for a while without contradiction, everything had paused; if a
    stream contradicts it, the timestamps of all streams that jumped are wrong. Sensors often share
    a clock, so that several streams that jump together prove nothing.
    """
    times = states.clocks[clock]
    stream_bit = 1 << (stream + 1)  # the lowest bit is for samples that only show the time
    if times[TO_US] != NEVER_US:
        if t_us - times[FROM_US] < (times[TO_US] - times[FROM_US]) // 2:
            _reject_jump(states, out, row, clock)
        else:
            times[BY] |= stream_bit
            several = times[BY] & (times[BY] - 1) != 0
            if t_us - times[TO_US] > (SEVERAL_CONFIRM_US if several else SINGLE_CONFIRM_US):
                _accept_pause(states, out, row, clock)
    if times[NEWEST_US] == NEVER_US or not _jumps_ahead(states, stream, clock, t_us):
        return True
    if times[TO_US] == NEVER_US:
        times[FROM_US], times[TO_US], times[BY] = (times[NEWEST_US], t_us, stream_bit)
    return False


@compiled
def _reject_jump(states: StreamStates, out: StreamAnomalies, row: int, clock: int) -> None:
    """Time did not jump: report the streams that did, if they are known to use this clock."""
    times = states.clocks[clock]
    now_us = times[NEWEST_US]
    for s in range(LINK):
        count = states.counts[s]
        if times[BY] >> (s + 1) & 1 and count[CLOCK] == clock and count[COUNT] >= RHYTHM_SAMPLES:
            if s != SATELLITES and now_us - count[REPORTED_US] >= REPEAT_US:
                _add_anomaly(
                    out, row, now_us, s, JUMPED_AHEAD, (times[TO_US] - times[FROM_US]) * 1e-6
                )
                count[REPORTED_US] = now_us
            count[DUE_US] = now_us + _limit_us(states.usual, s)  # it is wrong, but not silent
    times[TO_US] = NEVER_US


@compiled
def _jumps_ahead(states: StreamStates, stream: int, clock: int, t_us: int) -> bool:
    """Whether a sample is further ahead than its stream alone can move the time."""
    times = states.clocks[clock]
    ahead_us: int = t_us - times[NEWEST_US]
    if stream < 0 or states.counts[stream, COUNT] < RHYTHM_SAMPLES:
        # After a jump of others, a stream without a rhythm can only confirm it.
        return ahead_us > (SILENT_US if times[TO_US] == NEVER_US else TIME_JUMP_US)
    regular_us = (
        REGULAR_INTERVALS * states.usual[stream, INTERVAL]
    )  # a slow stream may advance the time by itself
    return ahead_us > TIME_JUMP_US and t_us - states.counts[stream, LAST_US] > regular_us


@compiled
def _accept_pause(states: StreamStates, out: StreamAnomalies, row: int, clock: int) -> None:
    """The link had paused: report it if that was long, and reset the silence of every stream."""
    times = states.clocks[clock]
    for e in range(times[FROM_US] + _limit_us(states.usual, LINK), times[TO_US], REPEAT_US):
        _add_anomaly(out, row, e, LINK, SILENT, (e - times[FROM_US]) * 1e-6)
    newest_us = times[TO_US]
    for s in range(LINK):
        if states.counts[s, CLOCK] == clock and states.counts[s, COUNT] > 0:
            heard_us = max(times[TO_US], states.counts[s, WAITED_US])
            states.counts[s, LAST_US] = states.counts[s, RECEIVED_US] = heard_us
            states.counts[s, ELAPSED_AT_US] = NEVER_US  # samples since then were not counted
            states.counts[s, DUE_US] = heard_us + _limit_us(states.usual, s)
            newest_us = max(newest_us, heard_us)
    times[NEWEST_US], times[TO_US] = newest_us, NEVER_US


@compiled
def _find_silent_streams(
    states: StreamStates, out: StreamAnomalies, row: int, stream: int, clock: int, t_us: int
) -> None:
    """Report the streams that are silent at `t_us`, and compute until when none can be: the test is
    skipped until then, as a stream received later may be silent for as long."""
    none_silent_us = t_us + SILENT_US
    for s in range(LINK):
        count = states.counts[s]
        if s == stream or count[COUNT] < LEARNED_SAMPLES or count[CLOCK] != clock:
            continue
        while count[DUE_US] <= t_us:
            _add_anomaly(
                out, row, count[DUE_US], s, SILENT, (count[DUE_US] - count[RECEIVED_US]) * 1e-6
            )
            count[DUE_US] += REPEAT_US
        none_silent_us = min(none_silent_us, count[DUE_US])
    states.clocks[clock, NONE_SILENT_US] = none_silent_us


@compiled
def _stamp_is_wrong(
    states: StreamStates, out: StreamAnomalies, row: int, s: int, t_us: int, newest_us: int
) -> bool:
    """Whether a sample's stamp goes back, is frozen or too late, which is reported."""
    count = states.counts[s]
    gap_us, late_us = t_us - count[LAST_US], newest_us - t_us
    limit_us = states.usual[s, LATENESS] + max(LATE_US, SPREAD_FACTOR * states.usual[s, SPREAD])
    if gap_us < -BACK_US:
        _add_anomaly(out, row, newest_us, s, JUMPED_BACK, -gap_us * 1e-6)
        return True
    if count[SAME_STAMPS] >= FROZEN_STAMPS and newest_us - count[REPORTED_US] >= REPEAT_US:
        anomaly = FROZEN_TIME
    elif count[COUNT] >= LEARNED_SAMPLES and late_us > limit_us:
        anomaly = LATE
    else:
        return False
    if newest_us - count[REPORTED_US] >= REPEAT_US:
        _add_anomaly(out, row, newest_us, s, anomaly, late_us * 1e-6)
        count[REPORTED_US] = newest_us
    return True


@inlined
def _learn(usual: Vector, s: int, count: int, gap_us: int, late_us: int) -> None:
    """Update a stream's interval and lateness from a regular sample."""
    share = max(SHARE, 1.0 / (1.0 + count))
    if count < LEARNED_SAMPLES or gap_us < INTERVALS * usual[s, INTERVAL]:
        usual[s, INTERVAL] += share * (gap_us - usual[s, INTERVAL])
    usual[s, SPREAD] += share * (abs(late_us - usual[s, LATENESS]) - usual[s, SPREAD])
    usual[s, LATENESS] += share * (late_us - usual[s, LATENESS])
    if count >= RHYTHM_SAMPLES and gap_us < _limit_us(usual, s):
        usual[s, PAUSE] = max(gap_us, usual[s, PAUSE] * (1.0 - gap_us / FORGOTTEN_US))


@compiled
def _rate_is_wrong(
    states: StreamStates,
    out: StreamAnomalies,
    row: int,
    s: int,
    share: float,
    together: float,
    t_us: int,
) -> None:
    """Report a stream with a burst or a sparse rate."""
    faulty = s if together > 0.0 or _another_is_regular(states, s) else LINK
    if t_us - states.counts[faulty, REPORTED_US] >= REPEAT_US:
        anomaly, amount = (BURSTING, together) if together > 0.0 else (SPARSE, 1.0 - share)
        _add_anomaly(out, row, t_us, faulty, anomaly, amount)
        states.counts[faulty, REPORTED_US] = t_us


@compiled
def _another_is_regular(states: StreamStates, stream: int) -> bool:
    """Whether another stream of known rate is regular, or none is known; else it is the link."""
    others = False
    for s in range(LINK):
        interval_s = states.usual[s, INTERVAL] * 1e-6
        if s != stream and is_rate_known(states.rates, s, interval_s):
            others = True
            if missing_share(states.rates, s, interval_s) < SINKING_SHARE:
                return True
    return not others


@inlined
def _repeated(
    last: Vector, runs: NDArray[np.int64], s: int, known: bool, values: Vector, row: int,
    width: int, t_us: int,
) -> float:  # fmt: skip
    """For how long one of a sensor's numbers has repeated beyond its own past, in s."""
    worst = 0.0
    for i in range(width):
        run, longest = runs[s, i, RUN], runs[s, i, LONGEST]
        if values[row, i] == last[s, i]:
            runs[s, i, RUN] = run + 1
            for_us = t_us - runs[s, i, SINCE_US]
            most = RUN_FACTOR * longest + RUN_MORE
            if known and longest <= STILL_SAMPLES and run + 1 > most and for_us >= RUN_US:
                worst = max(worst, for_us * 1e-6)
            if not known:
                runs[s, i, LONGEST] = max(longest, run + 1)
        else:
            if run <= RUN_FACTOR * longest + RUN_MORE:
                runs[s, i, LONGEST] = max(longest, run)
            runs[s, i, RUN], runs[s, i, SINCE_US] = 0, t_us
            last[s, i] = values[row, i]
    return worst


@compiled
def _fix_repeated(states: StreamStates, s: int, numbers: Vector, t_us: int) -> float:
    """Repetition of a fix, whose numbers repeat together, tested only while it reports motion."""
    same = True
    for i in range(FIX_NUMBERS):
        same &= numbers[i] == states.values[s, i]
        states.values[s, i] = numbers[i]
    run = states.runs[s, 0]
    if not same or not np.hypot(numbers[FIX_VELOCITY], numbers[FIX_VELOCITY + 1]) > MOVING_MPS:
        run[SINCE_US], run[RUN] = t_us, 0
        return 0.0
    run[RUN] += 1
    for_us = t_us - run[SINCE_US]
    return for_us * 1e-6 if run[RUN] >= FROZEN_STAMPS and for_us >= RUN_US else 0.0


@inlined
def _is_from_receiver(states: StreamStates, s: int, source: float) -> bool:
    """Whether a fix is the receiver's own: those that an autopilot forwards are late and repeat."""
    known = states.values[s, FIX_SOURCE]
    if source == known:
        return True
    if source != OWN_SOURCE and not np.isnan(known):
        return False
    states.values[s, FIX_SOURCE], states.counts[s, COUNT] = source, 0
    return True


@compiled
def track_streams(
    kind: Indices, t_us: Stamps, values: Vector, states: StreamStates, out: StreamAnomalies
) -> None:
    """Process the samples of a block, kind (n,), t_us (n,), values (n, w), in order."""
    counts, usual, last, runs, rates, clocks = states
    for row in range(len(kind)):
        s = STREAM_OF[kind[row]]
        if s == -2 or t_us[row] <= 0:  # broadcasts, and samples without a stamp
            continue
        if kind[row] == IMU:
            s = min(max(int(values[row, IMU_ID]), 0), IMUS - 1)
        elif kind[row] == FIX and not _is_from_receiver(states, s, values[row, FIX_SOURCE]):
            s = -1
        now_us = t_us[row]
        clock = 1 if now_us > EPOCH_1970_US else 0
        ahead_us = now_us - clocks[clock, NEWEST_US]  # only a jump needs more than this
        suspect = ahead_us > TIME_JUMP_US or clocks[clock, TO_US] != NEVER_US
        if suspect and not _accepts_time(states, out, row, s, clock, now_us):
            if s >= 0:
                counts[s, WAITED_US] = now_us
            continue
        newest_us = clocks[clock, NEWEST_US]
        if now_us > newest_us:
            if newest_us != NEVER_US:
                step_us = now_us - newest_us
                usual[LINK, INTERVAL] += SHARE * (step_us - usual[LINK, INTERVAL])
                clocks[clock, ELAPSED_US] += min(step_us, int(INTERVALS * usual[LINK, INTERVAL]))
            clocks[clock, NEWEST_US] = newest_us = now_us
            if now_us >= clocks[clock, NONE_SILENT_US]:
                _find_silent_streams(states, out, row, s, clock, now_us)
        if s < 0:
            continue
        if counts[s, COUNT] > 0 and counts[s, CLOCK] == clock:
            gap_us, late_us = now_us - counts[s, LAST_US], newest_us - now_us
            counts[s, SAME_STAMPS] = counts[s, SAME_STAMPS] + 1 if gap_us == 0 else 0
            wrong = (gap_us <= 0 or late_us > LATE_US) and _stamp_is_wrong(
                states, out, row, s, now_us, newest_us
            )
            if gap_us > 0 and not wrong:
                _learn(usual, s, counts[s, COUNT], gap_us, late_us)
                share = 0.0
                if gap_us < _limit_us(usual, s) and counts[s, ELAPSED_AT_US] != NEVER_US:
                    elapsed_us = clocks[clock, ELAPSED_US] - counts[s, ELAPSED_AT_US]
                    share = count_sample(rates, s, elapsed_us * 1e-6, usual[s, INTERVAL] * 1e-6)
                frozen = late_us > 0 and newest_us == counts[s, RECEIVED_US]
                together = burst_size(rates, s, frozen, counts[s, COUNT] >= LEARNED_VALUES)
                if share > 0.0 or together > 0.0:
                    _rate_is_wrong(states, out, row, s, share, together, newest_us)
        if kind[row] == FIX:
            for_s = _fix_repeated(states, s, values[row], now_us)
        else:
            known, width = counts[s, COUNT] >= LEARNED_VALUES, NUMBERS[kind[row]]
            for_s = _repeated(last, runs, s, known, values, row, width, now_us)
        if for_s > 0.0 and now_us - counts[s, REPORTED_US] >= REPEAT_US:
            _add_anomaly(out, row, now_us, s, REPEATED, for_s)
            counts[s, REPORTED_US] = now_us
        counts[s, LAST_US], counts[s, CLOCK] = now_us, clock
        counts[s, RECEIVED_US], counts[s, DUE_US] = newest_us, newest_us + _limit_us(usual, s)
        counts[s, ELAPSED_AT_US] = clocks[clock, ELAPSED_US]
        counts[s, COUNT] += 1
