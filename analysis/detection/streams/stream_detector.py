"""Detects stream anomalies: silence, repetition, a wrong rate, frozen or jumping timestamps.

A sensor is faulty, whatever its values, if it falls silent, its samples are sparse or come in
bursts, it repeats itself beyond its own noise and resolution, or its timestamps are wrong. If all
streams pause together, the link was lost. Results are repeated every half second.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from analysis.detection.detector_registry import REPEAT_US, BlockDetector, RowResults
from analysis.detection.streams.stream_rate import SINKING_SHARE
from analysis.detection.streams.stream_times import (
    FIX_SOURCE,
    FROZEN_STAMPS,
    INTERVALS,
    LEARNED_SAMPLES,
    LEARNED_VALUES,
    SHARE,
    SILENT_US,
    Clock,
    SampleStream,
)
from analysis.results import pattern_alarm
from analysis.samples.block import FIX, IMU, IMU_ID, NEVER_US, Block

SILENT = "silent for {:.2f} s"
REPEATED = "the same value for {:.2f} s"
FROZEN_TIME = "its timestamp is frozen, {:.2f} s behind"
JUMPED_AHEAD = "its timestamp jumps forward by {:.2f} s"
JUMPED_BACK = "its timestamp jumps back by {:.2f} s"
LATE = "{:.2f} s late"
SPARSE = "rate is {:.2f} of the usual"
BURSTING = "{:.0f} samples at once"

IMUS = 3  # streams of their own
STREAMS = ("imu", "imu", "imu", "mag", "baro", "airspeed", "range", "vision", "gps-position",
           "satellites", "link")  # fmt: skip
# SampleStream by kind of sample; -1: shows only the time, -2: has a time of its own.
STREAM_OF = (0, 3, 4, 5, 6, 7, -1, -1, 8, 9, -2, -2, -2, -2)
NUMBERS = (6, 3, 1, 1, 1, 3, 0, 0, 0, 0, 0, 0, 0, 0)  # how many are measured, by kind
SHOWS_TIME = np.array(STREAM_OF) != -2  # broadcasts and samples with a time of their own do not

TIME_JUMP_US = 200_000  # smallest jump ahead: an interval at 5 Hz
SEVERAL_CONFIRM_US, SINGLE_CONFIRM_US = 250_000, 1_000_000  # confirm a jump of several, of one
REGULAR_INTERVALS = 1.5  # usual intervals after which a sample is still regular
BACK_US = 20_000  # jump back: more than frames that a link swaps
EPOCH_1970_US = 100_000_000_000_000  # larger stamps count from 1970
MOST = 10_000  # results of one block

Anomaly = tuple[int, SampleStream, str, float]  # stamp, subject, reason, its amount


@dataclass
class StreamStates:
    """The streams, the link that all share, and the clocks from boot and from 1970."""

    streams: list[SampleStream] = field(
        default_factory=lambda: [SampleStream(name) for name in STREAMS[:-1]]
    )
    link: SampleStream = field(default_factory=lambda: SampleStream(STREAMS[-1]))
    clocks: tuple[Clock, Clock] = field(default_factory=lambda: (Clock(), Clock()))

    def add(self, kind: int, t_us: int, values: Sequence[float]) -> list[Anomaly]:
        """The anomalies that the next sample shows."""
        found: list[Anomaly] = []
        stream = self._stream_of(kind, values)
        clock = self.clocks[t_us > EPOCH_1970_US]
        # Only a jump needs more than this.
        suspect = t_us - clock.newest_us > TIME_JUMP_US or clock.to_us != NEVER_US
        if suspect and not self._accepts_time(found, stream, clock, t_us):
            if stream is not None:
                stream.waited_us = t_us
            return found
        if t_us > clock.newest_us:
            if clock.newest_us != NEVER_US:
                step_us = t_us - clock.newest_us
                self.link.interval_us += SHARE * (step_us - self.link.interval_us)
                clock.elapsed_us += min(step_us, int(INTERVALS * self.link.interval_us))
            clock.newest_us = t_us
            if t_us >= clock.none_silent_us:
                self._find_silent(found, stream, clock, t_us)
        if stream is None:
            return found
        if stream.count > 0 and stream.clock is clock:
            self._test_times(found, stream, clock, t_us)
        if kind == FIX:
            for_us = stream.fix_repetition_us(values, t_us)
        else:
            for_us = stream.repetition_us(values[: NUMBERS[kind]], t_us)
        if for_us > 0 and stream.may_report(t_us):
            found.append((t_us, stream, REPEATED, for_us * 1e-6))
        stream.last_us, stream.clock, stream.received_us = t_us, clock, clock.newest_us
        stream.due_us = clock.newest_us + stream.limit_us
        stream.elapsed_at_us = clock.elapsed_us
        stream.count += 1
        return found

    def _stream_of(self, kind: int, values: Sequence[float]) -> SampleStream | None:
        number = STREAM_OF[kind]
        if kind == IMU:
            number = min(max(int(values[IMU_ID]), 0), IMUS - 1)
        elif kind == FIX and not self.streams[number].is_from_receiver(values[FIX_SOURCE]):
            return None
        return self.streams[number] if number >= 0 else None

    def _accepts_time(
        self, found: list[Anomaly], stream: SampleStream | None, clock: Clock, t_us: int
    ) -> bool:
        """Whether a sample's time is accepted; a time that jumps ahead has to be confirmed.

        If time continues from there for a while without contradiction, everything had paused; if a
        stream contradicts it, the timestamps of all streams that jumped are wrong. Sensors often
        share a clock, so that several streams that jump together prove nothing.
        """
        if clock.to_us != NEVER_US:
            if t_us - clock.from_us < (clock.to_us - clock.from_us) // 2:
                self._reject_jump(found, clock)
            else:
                clock.jumped.add(stream)
                several = len(clock.jumped) > 1
                if t_us - clock.to_us > (SEVERAL_CONFIRM_US if several else SINGLE_CONFIRM_US):
                    self._accept_pause(found, clock)
        if clock.newest_us == NEVER_US or not _jumps_ahead(stream, clock, t_us):
            return True
        if clock.to_us == NEVER_US:
            clock.from_us, clock.to_us, clock.jumped = clock.newest_us, t_us, {stream}
        return False

    def _reject_jump(self, found: list[Anomaly], clock: Clock) -> None:
        """Time did not jump: report the streams that did, if they are known to use this clock."""
        now_us = clock.newest_us
        for stream in self.streams:
            if stream in clock.jumped and stream.clock is clock and stream.count >= LEARNED_SAMPLES:
                # Raw ranges have another message's timestamp.
                if stream.name != "satellites" and stream.may_report(now_us):
                    amount_s = (clock.to_us - clock.from_us) * 1e-6
                    found.append((now_us, stream, JUMPED_AHEAD, amount_s))
                stream.due_us = now_us + stream.limit_us  # it is wrong, but not silent
        clock.to_us = NEVER_US

    def _accept_pause(self, found: list[Anomaly], clock: Clock) -> None:
        """The link had paused: report it if that was long, and reset every stream's silence."""
        limit_us = max(SILENT_US, int(INTERVALS * self.link.interval_us))
        silent = range(clock.from_us + limit_us, clock.to_us, REPEAT_US)
        found += [(t, self.link, SILENT, (t - clock.from_us) * 1e-6) for t in silent[:MOST]]
        clock.newest_us = clock.to_us
        for stream in self.streams:
            if stream.clock is clock and stream.count > 0:
                heard_us = max(clock.to_us, stream.waited_us)
                stream.last_us = stream.received_us = heard_us
                stream.elapsed_at_us = NEVER_US  # samples since then were not counted
                stream.due_us = heard_us + stream.limit_us
                clock.newest_us = max(clock.newest_us, heard_us)
        clock.to_us = NEVER_US

    def _find_silent(
        self, found: list[Anomaly], own: SampleStream | None, clock: Clock, t_us: int
    ) -> None:
        """Report the streams that are silent, and compute until when none can be: the test is
        skipped until then, as a stream received later may be silent for as long."""
        clock.none_silent_us = t_us + SILENT_US
        for stream in self.streams:
            if stream is own or stream.count < LEARNED_SAMPLES or stream.clock is not clock:
                continue
            silent = range(stream.due_us, t_us + 1, REPEAT_US)
            since_us = stream.received_us
            found += [(due, stream, SILENT, (due - since_us) * 1e-6) for due in silent[:MOST]]
            stream.due_us += len(silent) * REPEAT_US
            clock.none_silent_us = min(clock.none_silent_us, stream.due_us)

    def _test_times(
        self, found: list[Anomaly], stream: SampleStream, clock: Clock, t_us: int
    ) -> None:
        """Test stamp and rate of a sample, and learn from it."""
        newest_us = clock.newest_us
        gap_us, late_us = t_us - stream.last_us, newest_us - t_us
        stream.same_stamps = stream.same_stamps + 1 if gap_us == 0 else 0
        if _stamp_is_wrong(found, stream, gap_us, late_us, newest_us) or gap_us <= 0:
            return
        stream.learn_times(gap_us, late_us)
        share, interval_s = 0.0, stream.interval_us * 1e-6
        if gap_us < stream.limit_us and stream.elapsed_at_us != NEVER_US:
            elapsed_us = clock.elapsed_us - stream.elapsed_at_us
            share = stream.rate.count_sample(elapsed_us * 1e-6, interval_s)
        frozen = late_us > 0 and newest_us == stream.received_us
        together = stream.rate.burst_size(frozen, stream.count >= LEARNED_VALUES)
        if share > 0.0 or together > 0:
            faulty = stream if together > 0 or self._another_is_regular(stream) else self.link
            if faulty.may_report(newest_us):
                reason, amount = (BURSTING, together) if together > 0 else (SPARSE, 1.0 - share)
                found.append((newest_us, faulty, reason, amount))

    def _another_is_regular(self, stream: SampleStream) -> bool:
        """Whether another known stream is regular, or none is known; else it is the link."""
        shares = [
            other.rate.missing_share(other.interval_us * 1e-6)
            for other in self.streams
            if other is not stream and other.rate.is_known(other.interval_us * 1e-6)
        ]
        return not shares or min(shares) < SINKING_SHARE


def _jumps_ahead(stream: SampleStream | None, clock: Clock, t_us: int) -> bool:
    """Whether a sample is further ahead than its stream alone can move the time."""
    ahead_us = t_us - clock.newest_us
    if stream is None or stream.count < LEARNED_SAMPLES:
        # After a jump of others, a stream without a rhythm can only confirm it.
        return ahead_us > (SILENT_US if clock.to_us == NEVER_US else TIME_JUMP_US)
    # A slow stream may advance the time by itself.
    regular_us = REGULAR_INTERVALS * stream.interval_us
    return ahead_us > TIME_JUMP_US and t_us - stream.last_us > regular_us


def _stamp_is_wrong(
    found: list[Anomaly], stream: SampleStream, gap_us: int, late_us: int, newest_us: int
) -> bool:
    """Whether a sample's stamp goes back, is frozen or too late, which is reported."""
    if gap_us < -BACK_US:
        found.append((newest_us, stream, JUMPED_BACK, -gap_us * 1e-6))
        return True
    if stream.same_stamps >= FROZEN_STAMPS and newest_us - stream.reported_us >= REPEAT_US:
        reason = FROZEN_TIME
    elif stream.is_late(late_us):
        reason = LATE
    else:
        return False
    if stream.may_report(newest_us):
        found.append((newest_us, stream, reason, late_us * 1e-6))
    return True


class StreamDetector(BlockDetector, frozen=True):
    """Tests every stream that has been received; without a `link` a pause of all is no anomaly."""

    channels: ClassVar = frozenset(STREAMS)
    state: ClassVar = StreamStates

    link: bool = True

    def step(self, block: Block, state: StreamStates) -> tuple[RowResults, StreamStates]:
        """The anomalies of the next samples by row, and the state, which is changed in place."""
        rows = np.flatnonzero(SHOWS_TIME[block.kind] & (block.t_us > 0))
        columns = rows.tolist(), block.kind[rows].tolist(), block.t_us[rows].tolist()
        values = zip(*block.values[rows, : FIX_SOURCE + 1].T.tolist(), strict=True)
        found = [
            (row, pattern_alarm(at_us, stream.name, reason.format(amount)))
            for row, kind, t_us, numbers in zip(*columns, values, strict=True)
            for at_us, stream, reason, amount in state.add(kind, t_us, numbers)
            if self.link or stream is not state.link
        ]
        return found[:MOST], state
