"""Fault functions of time: piecewise linear, with drawn numbers, and others.

A segment is f(t) = start + rate (t - at) on [at, at + for]; between segments the value is healthy.
`compat: param_gen` reproduces the Simulink function `param_gen` bit for bit, edges included: it is
open on the left and closed on the right, and at a joint the earlier segment holds.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mavproxy_fault.documents.document_check import NotFinite
from mavproxy_fault.fault_parts.series import Series, SeriesTable

if TYPE_CHECKING:
    from numpy.random import Generator

Mode = Literal["replace", "add", "scale"]
OVERLAP_TOLERANCE_S = 1e-6  # stamps are microseconds: what is closer than one is not an overlap
CLOSE_S = 1e-7  # nor do a sum of steps and a multiple of them differ that are closer
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
LONGEST_S = 1e9  # thirty years; microseconds then still fit a stamp of 64 bits with room for sums
Seconds = Annotated[float, Meta(ge=0, le=LONGEST_S)]
Duration = Annotated[float, Meta(gt=0, le=LONGEST_S)]


class Draw(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A number drawn at each start: `uniform: [low, high]` or `normal: [mean, sigma]`."""

    uniform: tuple[float, float] | None = None
    normal: tuple[float, NotNegative] | None = None

    def __post_init__(self) -> None:
        # Both or neither: there would be two answers, or none.
        if (self.uniform is None) == (self.normal is None):
            raise ValueError("a drawn number takes either uniform or normal")

    def number(self, rng: "Generator") -> float:
        """One draw."""
        if self.uniform is not None:
            return float(rng.uniform(*self.uniform))
        assert self.normal is not None
        return float(rng.normal(*self.normal))


class LinearSegment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One straight piece; times in seconds from the start of the fault, rate per second."""

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
    """Rectangles of one height: `width_s` long, every `period_s`."""

    amplitude: float
    period_s: Duration
    width_s: Duration


class LiveInput(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Values streamed from outside; one older than the time-out is refused."""

    timeout_s: Duration = 0.5


class Profile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A fault function: exactly one of its kinds, and how it meets the healthy value.

    `mode` defaults to what the fault does (bias adds, scale scales, constant replaces).
    `otherwise` is used outside the segments in place of the healthy value.
    `time_sim_s` is only looked at by `compat: param_gen`, which checks the last segment against it.
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
            raise ValueError("a profile takes exactly one of segments, sine, impulses, table, live")
        if self.segments is not None:
            if not self.segments:
                raise ValueError("segments is empty; give at least one")
            # Overlaps are judged for our own rule; `param_gen` has a check of its own.
            if self.compat is None:
                check_segments(self.segments)
            else:
                check_param_gen(self.segments, self.time_sim_s)

    def new_state(self, rng: "Generator") -> Any:
        """What the profile remembers: drawn segments, an open table, or the newest live value."""
        if self.segments is not None:
            # Drawn once per start, so that a repeated fault draws anew.
            return draw_segments(self.segments, rng)
        if self.table is not None:
            return Series(self.table)
        return None

    def value(self, t_s: float, state: Any) -> float | None:
        """The function at a time, or None where it says nothing and the value stays healthy."""
        if self.segments is not None:
            found = piecewise_value(state, t_s, open_left=self.compat is not None)
        elif self.sine is not None:
            wave = self.sine
            found = wave.offset + wave.amplitude * math.sin(
                math.tau * wave.frequency_hz * t_s + wave.phase_rad
            )
        elif self.impulses is not None:
            train = self.impulses
            # Closed at the start, open at the end: a frame at the very edge belongs to one only.
            passed_s = time_since_period(t_s, train.period_s)
            found = train.amplitude if passed_s < train.width_s - CLOSE_S else None
        elif self.table is not None:
            found = state.at(t_s)
        else:
            assert self.live is not None
            # A stream that has stopped must not go on falsifying with its last value.
            fresh = state is not None and t_s - state[0] <= self.live.timeout_s
            found = state[1] if fresh else None
        return self.otherwise if found is None else found


Piece = tuple[float, float, float, float]  # at_s, for_s, start, rate


def draw_segments(segments: Sequence[LinearSegment], rng: "Generator") -> tuple[Piece, ...]:
    """The segments with every number drawn."""

    def number(given: float | Draw) -> float:
        return given.number(rng) if isinstance(given, Draw) else given

    return tuple((s.at_s, s.for_s, number(s.start), number(s.rate)) for s in segments)


def piecewise_value(segments: Sequence[Piece], t_s: float, *, open_left: bool) -> float | None:
    """The piecewise-linear function, None outside its segments.

    With `open_left` a piece holds on (at, at + for] as in `param_gen`, else on [at, at + for],
    where at a joint the later one holds.
    """
    if open_left:
        # param_gen takes the piece before the first whose start has not passed, sorted or not.
        k = next((i for i, piece in enumerate(segments) if t_s <= piece[0]), len(segments)) - 1
    else:
        # The newest piece that has begun; at a joint the later one.
        k = bisect_right(segments, t_s, key=lambda piece: piece[0]) - 1
    if k < 0:
        return None
    at_s, for_s, start, rate = segments[k]
    # Before its end; behind it the value is healthy until the next piece.
    return start + (t_s - at_s) * rate if t_s <= at_s + for_s else None


def time_since_period(t_s: float, period_s: float) -> float:
    """Seconds since the last whole period, robust against rounding."""
    # Stamps are sums of steps: just below a multiple of the period is meant to be that multiple.
    return t_s - int((t_s + CLOSE_S) / period_s) * period_s


def check_segments(segments: Sequence[LinearSegment]) -> None:
    """Refuse segments that overlap by more than a microsecond, or end before they start.

    Raises
    ------
    ValueError
        With the segments at fault.
    """
    for i, segment in enumerate(segments):
        if segment.for_s < 0:
            raise ValueError(f"segments[{i}].for_s = {segment.for_s} is negative; give 0 or more")
        end_s = segment.at_s + segment.for_s
        if i + 1 < len(segments) and segments[i + 1].at_s < end_s - OVERLAP_TOLERANCE_S:
            raise ValueError(
                f"segments[{i + 1}].at_s = {segments[i + 1].at_s} is before the end of the "
                f"one before, {end_s:.9g}; segments must follow one another"
            )


def check_param_gen(segments: Sequence[LinearSegment], time_sim_s: float | None) -> None:
    """The check of `param_gen`, rounding included: dt must not exceed the gap to the next start.

    Raises
    ------
    ValueError
        Where `param_gen` says "dt error".
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
