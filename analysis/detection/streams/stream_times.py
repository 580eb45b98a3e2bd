"""What is usual for a stream, and the time that all streams of a clock show.

A stream is the samples of one kind, and of one instance for an IMU. Its own past defines what is
usual: the interval of samples, their lateness, how often a value repeats. Clocks that count from
boot and from 1970 are tracked separately.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from analysis.detection.detector_registry import REPEAT_US
from analysis.detection.streams.fix_repeats import RUN_FACTOR, RUN_MORE, RUN_US, FixRepeats
from analysis.detection.streams.stream_rate import StreamRate
from analysis.samples.block import FIX_3D, FIX_TYPE, NEVER_US, SOURCES

OWN_SOURCE = SOURCES.index("HIL_GPS")
FIX_SOURCE = 10  # a fix's column of its source
FIX_NUMBERS = 5  # of a fix: position and level velocity

# Weight of an interval in the usual one; samples after which that is known, and what values do.
SHARE, LEARNED_SAMPLES, LEARNED_VALUES = 0.05, 20, 200
SILENT_US = 500_000  # shortest silence: two samples at 5 Hz are missing
INTERVALS = 5.0  # least silence in usual intervals: p 1e-5 on a link that loses a tenth
LATE_US = 300_000  # later than usual: a GPS fix under load, a radio's frame, may be 0.2 s late
FROZEN_STAMPS = 5  # equal stamps in a row: as many as INTERVALS
# A value that has repeated for longer is exempt: the IMU of a noise-free simulator at rest.
STILL_SAMPLES = 20


def accepts_source(known: float, source: float) -> bool:
    """Whether a fix is of the receiver that is followed, by the messages' numbers: the `known` one
    (NaN: none yet), or HIL_GPS."""
    return source in (known, OWN_SOURCE) or math.isnan(known)


@dataclass(slots=True, eq=False)
class Clock:
    """The time that the streams of a clock show, and a jump of it that is not yet resolved."""

    newest_us: int = NEVER_US
    none_silent_us: int = NEVER_US  # before it no stream can be silent
    from_us: int = NEVER_US
    to_us: int = NEVER_US  # NEVER_US without a jump
    jumped: set["SampleStream | None"] = field(
        default_factory=set
    )  # None: what only shows the time
    elapsed_us: int = NEVER_US  # without pauses of all streams


@dataclass(slots=True)
class _Number:
    """One of the numbers that a sensor measures: when it took its value, and its repetitions."""

    value: float = math.nan  # equals nothing: the first value is no repetition
    since_us: int = 0
    run: int = 0
    longest: int = 0


@dataclass(slots=True, eq=False)
class SampleStream:
    """The newest stamps of a stream, and its usual times in us."""

    name: str
    count: int = 0
    clock: Clock | None = None
    last_us: int = 0
    received_us: int = 0
    due_us: int = 0  # silent from then on
    waited_us: int = 0  # the newest stamp while a jump is unresolved
    reported_us: int = NEVER_US
    elapsed_at_us: int = 0
    same_stamps: int = 0
    interval_us: float = 0.0
    lateness_us: float = 0.0
    limit_us: int = SILENT_US  # for how long it may be silent
    rate: StreamRate = field(default_factory=StreamRate)
    numbers: list[_Number] = field(default_factory=lambda: [_Number() for _ in range(6)])
    source: float = math.nan  # of a fix
    repeats: FixRepeats = field(default_factory=FixRepeats)

    def may_report(self, t_us: int) -> bool:
        """Whether the last report is old enough; the new one then counts as the last."""
        if t_us - self.reported_us < REPEAT_US:
            return False
        self.reported_us = t_us
        return True

    def is_late(self, late_us: int) -> bool:
        """Whether a sample is later than usual."""
        return self.count >= LEARNED_SAMPLES and late_us > self.lateness_us + LATE_US

    def learn_times(self, gap_us: int, late_us: int) -> None:
        """Update interval and lateness from a regular sample."""
        share = max(SHARE, 1.0 / (1.0 + self.count))
        if self.count < LEARNED_SAMPLES or gap_us < INTERVALS * self.interval_us:
            self.interval_us += share * (gap_us - self.interval_us)
        self.lateness_us += share * (late_us - self.lateness_us)
        self.limit_us = max(SILENT_US, int(INTERVALS * self.interval_us))

    def is_from_receiver(self, source: float) -> bool:
        """Whether a fix is the receiver's own: those that an autopilot forwards are late."""
        if source != self.source and accepts_source(self.source, source):
            self.source, self.count, self.repeats = source, 0, FixRepeats()
        return source == self.source

    def repetition_us(self, values: Sequence[float], t_us: int) -> int:
        """For how long one of the sensor's numbers has repeated beyond its own past."""
        worst_us, known = 0, self.count >= LEARNED_VALUES
        for number, value in zip(self.numbers, values, strict=False):
            if value != number.value:
                number.value, number.since_us = value, t_us
                if number.run:
                    if number.run <= RUN_FACTOR * number.longest + RUN_MORE:
                        number.longest = max(number.longest, number.run)
                    number.run = 0
                continue
            number.run += 1
            for_us, most = t_us - number.since_us, RUN_FACTOR * number.longest + RUN_MORE
            if not known:
                number.longest = max(number.longest, number.run)
            elif number.longest <= STILL_SAMPLES and number.run > most and for_us >= RUN_US:
                worst_us = max(worst_us, for_us)
        return worst_us

    def fix_repetition_us(self, values: Sequence[float], t_us: int) -> int:
        """For how long a fix, whose numbers repeat together, has repeated beyond its past."""
        if values[FIX_TYPE] >= FIX_3D:
            known = tuple(0.0 if math.isnan(value) else value for value in values[:FIX_NUMBERS])
            self.repeats = self.repeats.updated(t_us, known)
        return t_us - self.repeats.since_us if self.repeats.frozen else 0
