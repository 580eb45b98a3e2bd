"""The samples of every stream in a row, compiled: silence, repetition, stamps; see `stream_watch`.

A stream is one kind of sample, of the IMU one instance. Its own past says what is usual: the time
between two samples, how late it is, how often a value stays the same. Clocks that count from boot
and from 1970 are kept apart.

Nearly every sample comes when it should. What it needs stands in the loop of `track_streams` and
takes arrays by themselves, since an array that is taken out of a record costs its count of
references; what is rare stands in functions of its own, which take the record.
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
from analysis.samples.block import FIX, FIX_VELOCITY, IMU, IMU_ID, SOURCES, Indices, Stamps
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled, inlined

SILENT, REPEATED, FROZEN_TIME, JUMPED_AHEAD, JUMPED_BACK, LATE, SPARSE, BURSTING = range(1, 9)
IMUS = 3
STREAMS = ("imu", "imu", "imu", "mag", "baro", "airspeed", "range", "vision", "gps-position",
           "satellites", "link")  # fmt: skip
LINK = len(STREAMS) - 1
SATELLITES = LINK - 1  # raw ranges have no stamp of their own, theirs is another message's
# By kind of sample its stream, and how many of its numbers are measured; -1: only a witness of time
STREAM_OF = (0, 3, 4, 5, 6, 7, -1, -1, 8, 9, -2, -2, -2, -2)
NUMBERS = (6, 3, 1, 1, 1, 3, 0, 0, 0, 0, 0, 0, 0, 0)
FIX_SOURCE, OWN_SOURCE = 10, SOURCES.index("HIL_GPS")  # a fix's column of who sent it
FIX_NUMBERS, MOVING_MPS = 5, 1.0  # of a fix: place and level velocity together, while it moves

LEARNED_SAMPLES, LEARNED_VALUES = 20, 200  # samples after which a stream and its values are known
SHARE = 0.05  # of a new interval in what is usual
SILENT_US = 500_000
TIME_JUMP_US = 200_000
SEVERAL_CONFIRM_US, SINGLE_CONFIRM_US = (
    250_000,
    1_000_000,
)  # for which a leap of several streams, of one, has to last
RHYTHM_SAMPLES = 5  # samples after which the interval of a stream is about known
REGULAR_INTERVALS = 1.5  # usual intervals after which a sample still comes as it should
INTERVALS = 5.0  # usual intervals that a pause must be long
PAUSE_FACTOR, FORGOTTEN_US = (
    1.5,
    60e6,
)  # longest pauses of late, in a log or on a link that loses much
LATE_US, SPREAD_FACTOR = 300_000, 8.0  # later than usual: at least, and in what is usual of that
BACK_US = 20_000
FROZEN_STAMPS = 5
# A repetition beyond what the sensor's own past shows
RUN_FACTOR, RUN_MORE, RUN_US = 3, 10, 500_000
STILL_SAMPLES = 20  # samples for which a number once stood in a sound sensor: then it tells nothing
EPOCH_1970_US = 100_000_000_000_000  # later stamps do not count from boot
REPEAT_US = 500_000  # between two results about the same trouble
NEVER_US = -(1 << 62)

INTERVAL, LATENESS, PAUSE, SPREAD = range(4)  # what is usual of a stream, the last of its lateness
# What is counted of a stream; the last: its newest stamp while a leap was not yet understood
LAST_US, COUNT, DUE_US, SAME_STAMPS, REPORTED_US, CLOCK, RECEIVED_US, ELAPSED_AT_US, WAITED_US = (
    range(9)
)
# Of each number of a stream: when it took its value, how often it stayed, the most that it ever did
SINCE_US, RUN, LONGEST = range(3)
# Of a clock: its newest stamp, before when nobody can be silent, a leap not yet understood, where
# BY has a bit for each who made it, and how far it went while samples came: without pauses of all
NEWEST_US, NONE_SILENT_US, FROM_US, TO_US, BY, ELAPSED_US = range(6)


class StreamStates(NamedTuple):
    """What is known of s streams; `track_streams` changes it in place.

    `counts` (s, 9), `usual` (s, 4): interval, lateness, longest pause and the spread of the
    lateness in us; the newest `values` (s, w) and the `runs` (s, w, 3) of each number; `rates`
    (s, 8) of `rate_kernel`; `clocks` (2, 6).
    """

    counts: NDArray[np.int64]
    usual: Vector
    values: Vector
    runs: NDArray[np.int64]
    rates: Vector
    clocks: NDArray[np.int64]


class StreamAnomalies(NamedTuple):
    """Troubles (k, 4): row, stamp, stream, what; how much (k,), in s, a share or samples; how many
    are `filled` (1,)."""

    rows: NDArray[np.int64]
    amounts: Vector
    filled: NDArray[np.int64]


@compiled
def _add_anomaly(
    found: StreamAnomalies, row: int, t_us: int, stream: int, what: int, amount: float
) -> None:
    at = found.filled[0]
    if at < len(found.rows):
        for i, number in enumerate((row, t_us, stream, what)):
            found.rows[at, i] = number
        found.amounts[at] = amount
        found.filled[0] += 1


@inlined
def _limit_us(usual: Vector, stream: int) -> int:
    own_us = max(INTERVALS * usual[stream, INTERVAL], PAUSE_FACTOR * usual[stream, PAUSE])
    limit_us: int = max(SILENT_US, int(own_us))
    return limit_us


@compiled
def _accepts_time(
    watched: StreamStates, found: StreamAnomalies, row: int, stream: int, clock: int, t_us: int
) -> bool:
    """Whether the time of a sample may be believed: one that leaps ahead has to wait.

    If time goes on from there for a while and nobody contradicts it, everything had paused; if
    somebody does, the stamps of all who leapt are wrong. Several sensors often share one clock, so
    that many who leap together prove nothing.
    """
    at = watched.clocks[clock]
    own = 1 << (stream + 1)  # the lowest bit is that of the witnesses
    if at[TO_US] != NEVER_US:
        if t_us - at[FROM_US] < (at[TO_US] - at[FROM_US]) // 2:
            _reject_jump(watched, found, row, clock)
        else:
            at[BY] |= own
            several = at[BY] & (at[BY] - 1) != 0
            if t_us - at[TO_US] > (SEVERAL_CONFIRM_US if several else SINGLE_CONFIRM_US):
                _accept_pause(watched, found, row, clock)
    if at[NEWEST_US] == NEVER_US or not _jumps_ahead(watched, stream, clock, t_us):
        return True
    if at[TO_US] == NEVER_US:
        at[FROM_US], at[TO_US], at[BY] = at[NEWEST_US], t_us, own
    return False


@compiled
def _reject_jump(watched: StreamStates, found: StreamAnomalies, row: int, clock: int) -> None:
    """Time did not leap: whoever did so is told, if it is known to have gone by this clock."""
    at = watched.clocks[clock]
    now_us = at[NEWEST_US]
    for s in range(LINK):
        count = watched.counts[s]
        if at[BY] >> (s + 1) & 1 and count[CLOCK] == clock and count[COUNT] >= RHYTHM_SAMPLES:
            if s != SATELLITES and now_us - count[REPORTED_US] >= REPEAT_US:
                _add_anomaly(found, row, now_us, s, JUMPED_AHEAD, (at[TO_US] - at[FROM_US]) * 1e-6)
                count[REPORTED_US] = now_us
            count[DUE_US] = now_us + _limit_us(watched.usual, s)  # it is wrong, but not silent
    at[TO_US] = NEVER_US


@compiled
def _jumps_ahead(watched: StreamStates, stream: int, clock: int, t_us: int) -> bool:
    """Whether a sample is further ahead of the newest than its stream alone is believed."""
    at = watched.clocks[clock]
    ahead_us: int = t_us - at[NEWEST_US]
    if stream < 0 or watched.counts[stream, COUNT] < RHYTHM_SAMPLES:
        # Where others have leapt, one without a rhythm only bears them out.
        return ahead_us > (SILENT_US if at[TO_US] == NEVER_US else TIME_JUMP_US)
    regular_us = (
        REGULAR_INTERVALS * watched.usual[stream, INTERVAL]
    )  # a slow stream alone may carry time on
    return ahead_us > TIME_JUMP_US and t_us - watched.counts[stream, LAST_US] > regular_us


@compiled
def _accept_pause(watched: StreamStates, found: StreamAnomalies, row: int, clock: int) -> None:
    """The whole link had paused: it is told if that was long, and nobody was silent on his own."""
    at = watched.clocks[clock]
    for e in range(at[FROM_US] + _limit_us(watched.usual, LINK), at[TO_US], REPEAT_US):
        _add_anomaly(found, row, e, LINK, SILENT, (e - at[FROM_US]) * 1e-6)
    newest_us = at[TO_US]
    for s in range(LINK):
        if watched.counts[s, CLOCK] == clock and watched.counts[s, COUNT] > 0:
            heard_us = max(at[TO_US], watched.counts[s, WAITED_US])
            watched.counts[s, LAST_US] = watched.counts[s, RECEIVED_US] = heard_us
            watched.counts[s, ELAPSED_AT_US] = NEVER_US  # who came since then was not counted
            watched.counts[s, DUE_US] = heard_us + _limit_us(watched.usual, s)
            newest_us = max(newest_us, heard_us)
    at[NEWEST_US], at[TO_US] = newest_us, NEVER_US


@compiled
def _find_silent_streams(
    watched: StreamStates, found: StreamAnomalies, row: int, stream: int, clock: int, t_us: int
) -> None:
    """Who has not come for too long when the time goes on to `t_us`; and until when nobody can be
    silent, so that nobody need be asked: whoever comes later may be silent as long himself."""
    quiet_us = t_us + SILENT_US
    for s in range(LINK):
        count = watched.counts[s]
        if s == stream or count[COUNT] < LEARNED_SAMPLES or count[CLOCK] != clock:
            continue
        while count[DUE_US] <= t_us:
            _add_anomaly(
                found, row, count[DUE_US], s, SILENT, (count[DUE_US] - count[RECEIVED_US]) * 1e-6
            )
            count[DUE_US] += REPEAT_US
        quiet_us = min(quiet_us, count[DUE_US])
    watched.clocks[clock, NONE_SILENT_US] = quiet_us


@compiled
def _stamp_is_wrong(
    watched: StreamStates, found: StreamAnomalies, row: int, s: int, t_us: int, newest_us: int
) -> bool:
    """Whether a sample's stamp goes back, stands or comes too late, which is told."""
    count = watched.counts[s]
    gap_us, late_us = t_us - count[LAST_US], newest_us - t_us
    limit_us = watched.usual[s, LATENESS] + max(LATE_US, SPREAD_FACTOR * watched.usual[s, SPREAD])
    if gap_us < -BACK_US:
        _add_anomaly(found, row, newest_us, s, JUMPED_BACK, -gap_us * 1e-6)
        return True
    if count[SAME_STAMPS] >= FROZEN_STAMPS and newest_us - count[REPORTED_US] >= REPEAT_US:
        what = FROZEN_TIME
    elif count[COUNT] >= LEARNED_SAMPLES and late_us > limit_us:
        what = LATE
    else:
        return False
    if newest_us - count[REPORTED_US] >= REPEAT_US:
        _add_anomaly(found, row, newest_us, s, what, late_us * 1e-6)
        count[REPORTED_US] = newest_us
    return True


@inlined
def _learn(usual: Vector, s: int, count: int, gap_us: int, late_us: int) -> None:
    """The interval and the lateness of a stream, from a sample as it should be."""
    share = max(SHARE, 1.0 / (1.0 + count))
    if count < LEARNED_SAMPLES or gap_us < INTERVALS * usual[s, INTERVAL]:
        usual[s, INTERVAL] += share * (gap_us - usual[s, INTERVAL])
    usual[s, SPREAD] += share * (abs(late_us - usual[s, LATENESS]) - usual[s, SPREAD])
    usual[s, LATENESS] += share * (late_us - usual[s, LATENESS])
    if count >= RHYTHM_SAMPLES and gap_us < _limit_us(usual, s):
        usual[s, PAUSE] = max(gap_us, usual[s, PAUSE] * (1.0 - gap_us / FORGOTTEN_US))


@compiled
def _rate_is_wrong(
    watched: StreamStates,
    found: StreamAnomalies,
    row: int,
    s: int,
    share: float,
    together: float,
    t_us: int,
) -> None:
    """Tell of a stream that several samples of it come at once, or too few."""
    who = s if together > 0.0 or _another_is_regular(watched, s) else LINK
    if t_us - watched.counts[who, REPORTED_US] >= REPEAT_US:
        what, amount = (BURSTING, together) if together > 0.0 else (SPARSE, 1.0 - share)
        _add_anomaly(found, row, t_us, who, what, amount)
        watched.counts[who, REPORTED_US] = t_us


@compiled
def _another_is_regular(watched: StreamStates, stream: int) -> bool:
    """Whether a stream whose rate is known comes as usual, or no other is: else all sink."""
    others = False
    for s in range(LINK):
        interval_s = watched.usual[s, INTERVAL] * 1e-6
        if s != stream and is_rate_known(watched.rates, s, interval_s):
            others = True
            if missing_share(watched.rates, s, interval_s) < SINKING_SHARE:
                return True
    return not others


@inlined
def _repeated(
    last: Vector, runs: NDArray[np.int64], s: int, known: bool, values: Vector, row: int,
    width: int, t_us: int,
) -> float:  # fmt: skip
    """For how long one of a sensor's numbers has stayed the same against its own past, in s."""
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
def _fix_repeated(watched: StreamStates, s: int, numbers: Vector, t_us: int) -> float:
    """The same for a fix, whose numbers repeat together, and only while it says that it moves."""
    same = True
    for i in range(FIX_NUMBERS):
        same &= numbers[i] == watched.values[s, i]
        watched.values[s, i] = numbers[i]
    run = watched.runs[s, 0]
    if not same or not np.hypot(numbers[FIX_VELOCITY], numbers[FIX_VELOCITY + 1]) > MOVING_MPS:
        run[SINCE_US], run[RUN] = t_us, 0
        return 0.0
    run[RUN] += 1
    for_us = t_us - run[SINCE_US]
    return for_us * 1e-6 if run[RUN] >= FROZEN_STAMPS and for_us >= RUN_US else 0.0


@inlined
def _is_from_receiver(watched: StreamStates, s: int, source: float) -> bool:
    """Whether a fix is the receiver's own: what an autopilot passes on comes late and repeats."""
    known = watched.values[s, FIX_SOURCE]
    if source == known:
        return True
    if source != OWN_SOURCE and not np.isnan(known):
        return False
    watched.values[s, FIX_SOURCE], watched.counts[s, COUNT] = source, 0
    return True


@compiled
def track_streams(
    kind: Indices, t_us: Stamps, values: Vector, watched: StreamStates, found: StreamAnomalies
) -> None:
    """Look at the samples of a block, kind (n,), t_us (n,), values (n, w), one after the other."""
    counts, usual, last, runs, rates, clocks = watched
    for row in range(len(kind)):
        s = STREAM_OF[kind[row]]
        if s == -2 or t_us[row] <= 0:  # broadcasts, and what has no stamp yet
            continue
        if kind[row] == IMU:
            s = min(max(int(values[row, IMU_ID]), 0), IMUS - 1)
        elif kind[row] == FIX and not _is_from_receiver(watched, s, values[row, FIX_SOURCE]):
            s = -1
        now_us = t_us[row]
        clock = 1 if now_us > EPOCH_1970_US else 0
        # Nothing has to be understood unless this sample leaps, or one has leapt before it.
        suspect = (
            now_us - clocks[clock, NEWEST_US] > TIME_JUMP_US or clocks[clock, TO_US] != NEVER_US
        )
        if suspect and not _accepts_time(watched, found, row, s, clock, now_us):
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
                _find_silent_streams(watched, found, row, s, clock, now_us)
        if s < 0:
            continue
        if counts[s, COUNT] > 0 and counts[s, CLOCK] == clock:
            gap_us, late_us = now_us - counts[s, LAST_US], newest_us - now_us
            counts[s, SAME_STAMPS] = counts[s, SAME_STAMPS] + 1 if gap_us == 0 else 0
            wrong = (gap_us <= 0 or late_us > LATE_US) and _stamp_is_wrong(
                watched, found, row, s, now_us, newest_us
            )
            if gap_us > 0 and not wrong:
                _learn(usual, s, counts[s, COUNT], gap_us, late_us)
                share = 0.0
                if gap_us < _limit_us(usual, s) and counts[s, ELAPSED_AT_US] != NEVER_US:
                    went_us = clocks[clock, ELAPSED_US] - counts[s, ELAPSED_AT_US]
                    share = count_sample(rates, s, went_us * 1e-6, usual[s, INTERVAL] * 1e-6)
                stands = late_us > 0 and newest_us == counts[s, RECEIVED_US]
                together = burst_size(rates, s, stands, counts[s, COUNT] >= LEARNED_VALUES)
                if share > 0.0 or together > 0.0:
                    _rate_is_wrong(watched, found, row, s, share, together, newest_us)
        if kind[row] == FIX:
            for_s = _fix_repeated(watched, s, values[row], now_us)
        else:
            known, width = counts[s, COUNT] >= LEARNED_VALUES, NUMBERS[kind[row]]
            for_s = _repeated(last, runs, s, known, values, row, width, now_us)
        if for_s > 0.0 and now_us - counts[s, REPORTED_US] >= REPEAT_US:
            _add_anomaly(found, row, now_us, s, REPEATED, for_s)
            counts[s, REPORTED_US] = now_us
        counts[s, LAST_US], counts[s, CLOCK] = now_us, clock
        counts[s, RECEIVED_US], counts[s, DUE_US] = newest_us, newest_us + _limit_us(usual, s)
        counts[s, ELAPSED_AT_US] = clocks[clock, ELAPSED_US]
        counts[s, COUNT] += 1
