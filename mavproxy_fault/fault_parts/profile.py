"""Fault profiles: piecewise linear (also with random numbers), sine, impulses, files, live values.

A segment is f(t) = start + rate (t - at) on [at, at + for]; between segments the value is healthy.
`compat: param_gen` reproduces the Simulink function `param_gen` bit for bit, including the edges:
segments are open on the left and closed on the right, and the earlier one holds at a joint.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mavproxy_fault.documents.document_check import NotFinite, NotNegative, Positive
from mavproxy_fault.fault_parts.fault import Generator
from mavproxy_fault.fault_parts.memory import NO_MEMORY, Memory
from mavproxy_fault.fault_parts.series import SeriesTable, read_series

Mode = Literal["replace", "add", "scale"]
MODES: dict[Mode, float] = {"add": 0.0, "scale": 1.0, "replace": 2.0}  # as numbers of a rule
SEGMENTS, SINE, IMPULSES, LIVE = 0.0, 1.0, 2.0, 3.0  # kinds, as numbers of a rule
PIECE = 4  # numbers of a segment in memory
OVERLAP_TOLERANCE_S = 1e-6  # one microsecond, the resolution of timestamps
CLOSE_S = 1e-7  # rounding of sums of time steps; below the resolution of timestamps
LONGEST_S = 1e9  # thirty years: sums in microseconds still fit 64 bits
Seconds = Annotated[float, Meta(ge=0, le=LONGEST_S)]
Duration = Annotated[float, Meta(gt=0, le=LONGEST_S)]


class Draw(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A random number drawn at each start: `uniform: [low, high]` or `normal: [mean, sigma]`."""

    uniform: tuple[float, float] | None = None
    normal: tuple[float, NotNegative] | None = None

    def __post_init__(self) -> None:
        if (self.uniform is None) == (self.normal is None):
            raise ValueError("a random number needs exactly one of uniform and normal")

    def number(self, rng: Generator) -> float:
        """Draw the number."""
        if self.uniform is not None:
            return float(rng.uniform(*self.uniform))
        assert self.normal is not None
        return float(rng.normal(*self.normal))


class LinearSegment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One linear segment; times [s] from the start of the fault, rate per second."""

    at_s: Annotated[float, Meta(ge=-LONGEST_S, le=LONGEST_S)]
    for_s: Annotated[float, Meta(le=LONGEST_S)]
    start: NotFinite | Draw
    rate: float | Draw = 0.0


class SineProfile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """offset + amplitude sin(2 pi frequency t + phase)."""

    amplitude: float
    frequency_hz: Positive
    phase_rad: float = 0.0
    offset: float = 0.0


class Impulses(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Rectangular impulses of `width_s`, every `period_s`."""

    amplitude: float
    period_s: Duration
    width_s: Duration


class LiveInput(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Values streamed by live control; one older than the timeout is ignored."""

    timeout_s: Duration = 0.5


class Profile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A fault profile: exactly one kind of function, and how it acts on the healthy value.

    `mode` defaults to that of the fault (bias adds, scale scales, constant replaces).
    `otherwise` replaces the healthy value outside the segments.
    `time_sim_s` is used by `compat: param_gen` only, to check the end of the last segment.
    """

    mode: Mode | None = None
    segments: tuple[LinearSegment, ...] | None = None
    sine: SineProfile | None = None
    impulses: Impulses | None = None
    table: SeriesTable | None = None
    live: LiveInput | None = None
    otherwise: NotFinite | None = None
    compat: Literal["param_gen"] | None = None
    time_sim_s: float | None = None

    def __post_init__(self) -> None:
        kinds = (self.segments, self.sine, self.impulses, self.table, self.live)
        if sum(kind is not None for kind in kinds) != 1:
            raise ValueError("a profile needs exactly one of segments, sine, impulses, table, live")
        if self.segments is not None:
            if not self.segments:
                raise ValueError("segments is empty; give at least one")
            # `param_gen` has its own check for overlaps.
            if self.compat is None:
                check_segments(self.segments)
            else:
                check_param_gen(self.segments, self.time_sim_s)

    @property
    def numbers(self) -> tuple[float, ...]:
        """The parameters of `profile_value`: kind, what holds otherwise, and those of the kind."""
        otherwise = (float(self.otherwise is not None), self.otherwise or 0.0)
        if self.segments is not None:
            return SEGMENTS, *otherwise, float(self.compat is not None)
        if self.sine is not None:
            wave = self.sine
            return SINE, *otherwise, wave.offset, wave.amplitude, wave.frequency_hz, wave.phase_rad
        if self.impulses is not None:
            train = self.impulses
            return IMPULSES, *otherwise, train.amplitude, train.period_s, train.width_s
        assert self.live is not None
        return LIVE, *otherwise, self.live.timeout_s

    @property
    def remembers(self) -> bool:
        """Whether `profile_value` needs memory."""
        return self.segments is not None or self.live is not None

    def memory(self, rng: "Generator | None") -> Memory:
        """Return the memory of `profile_value`: segments with drawn numbers, or no live value."""
        if self.live is not None:
            return Memory(3)
        if self.segments is None:
            return NO_MEMORY
        # Drawn once per start, so that a repeated fault draws new numbers.
        memory = Memory(1 + PIECE * len(self.segments))
        memory.write([float(len(self.segments)), *draw_segments(self.segments, rng)])
        return memory

    def new_state(self, rng: Generator) -> Any:
        """Return the initial state: a series, or the memory of the other kinds."""
        return self.memory(rng) if self.table is None else read_series(self.table)

    def value(self, t_s: float, state: Any) -> float | None:
        """Return the value at a time; None where the field keeps its healthy value."""
        if self.table is not None:
            found: float | None = state.at(t_s)
            return self.otherwise if found is None else found
        held, value = profile_value(self.numbers, t_s, state.numbers)
        return value if held else None


def hold_live_value(memory: Memory | None, start_us: int, t_us: int, value: float) -> Memory:
    """Return the memory of a live profile with the value that arrived at `t_us`, by the time since
    the start of the fault, which its timeout needs."""
    memory = memory or Memory(3)
    memory.write([1.0, (t_us - start_us) / 1e6, value])
    return memory


def draw_segments(segments: Sequence[LinearSegment], rng: Any) -> Iterator[float]:
    """Yield the numbers of the segments (at_s, for_s, start, rate), random ones drawn."""
    for segment in segments:
        yield segment.at_s
        yield segment.for_s
        for given in (segment.start, segment.rate):
            yield given.number(rng) if isinstance(given, Draw) else given


def profile_value(p: Sequence[float], t_s: float, m: Any) -> tuple[bool, float]:
    """Return whether a profile holds at a time, and its value; a rule's function (`rules`)."""
    kind, otherwise, value = p[0], p[1] != 0.0, p[2]
    if kind == SINE:
        phase_rad = math.tau * p[5] * t_s + p[6]
        return True, p[3] + p[4] * math.sin(phase_rad)
    if kind == IMPULSES:
        # Half-open interval: closed at the start, open at the end.
        if time_since_period(t_s, p[4]) < p[5] - CLOSE_S:
            return True, p[3]
        return otherwise, value
    if kind == LIVE:
        # The last value of a stream that has stopped must not persist.
        if m[0] and t_s - m[1] <= p[3]:
            return True, m[2]
        return otherwise, value
    piece = -1
    for n in range(int(m[0])):
        begins_s = m[1 + PIECE * n]
        if p[3]:
            # param_gen takes the piece before the first one that has not started, sorted or not.
            if t_s <= begins_s:
                break
            piece = n
        elif begins_s <= t_s:  # the latest piece that has started
            piece = n
    one = 1 + PIECE * piece
    # After the end of a piece the value is healthy until the next one.
    if piece >= 0 and t_s <= m[one] + m[one + 1]:
        return True, m[one + 2] + (t_s - m[one]) * m[one + 3]
    return otherwise, value


def time_since_period(t_s: float, period_s: float) -> float:
    """Return the time [s] since the last multiple of the period, robust against rounding."""
    # Timestamps are sums of steps and may lie just below a multiple of the period.
    return t_s - int((t_s + CLOSE_S) / period_s) * period_s


def check_segments(segments: Sequence[LinearSegment]) -> None:
    """Refuse segments that overlap by more than a microsecond, or end before they start.

    Raises
    ------
    ValueError
        If there are such segments; the text names them.
    """
    for i, segment in enumerate(segments):
        if segment.for_s < 0:
            raise ValueError(f"segments[{i}].for_s = {segment.for_s} is negative; give 0 or more")
        end_s = segment.at_s + segment.for_s
        if i + 1 < len(segments) and segments[i + 1].at_s < end_s - OVERLAP_TOLERANCE_S:
            raise ValueError(
                f"segments[{i + 1}].at_s = {segments[i + 1].at_s} is before the end of the "
                f"previous segment, {end_s:.9g}; segments must not overlap"
            )


def check_param_gen(segments: Sequence[LinearSegment], time_sim_s: float | None) -> None:
    """Check segments as `param_gen` does: dt must not exceed the gap to the next start.

    Raises
    ------
    ValueError
        If `param_gen` would report "dt error".
    """
    if len(segments) == 1:
        return  # param_gen does not check a single segment
    ends = [segment.at_s for segment in segments[1:]]
    if time_sim_s is not None:
        ends.append(time_sim_s)
    for i, (segment, end_s) in enumerate(zip(segments, ends, strict=False)):
        if end_s - segment.at_s < segment.for_s:
            raise ValueError(
                f"segments[{i}].for_s = {segment.for_s} is longer than the {end_s - segment.at_s!r}"
                " s to the next start or the end (dt error); param_gen compares without tolerance"
            )
