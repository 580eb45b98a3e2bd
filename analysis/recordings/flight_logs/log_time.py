"""The time of every row of a flight log, whatever became of its stamps.

Rows stand in the order in which they were logged. Stamps place them by the vehicle's clock as long
as it runs on; where it is set back or forward, the log goes on all the same. Where stamps are
missing or zero, another time in the messages counts (that of the receiver), else the place in the
file. Only where the vehicle evidently started anew, boots are placed one after another.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.misdated_stamps import (
    FAR_US,
    FREQUENT_US,
    find_misdated,
    find_restarts,
)

Stamps = NDArray[np.int64]

PAUSE_US = 1_000_000  # between two boots in one file, whose real pause is not logged
STEP_US = 1_000  # chosen: between two messages in a row
STALE_US = 1_000_000  # chosen: sensors are sampled more often
LONGEST_GAP_US = 86_400_000_000  # one day; chosen: no log pauses longer
MOST_STALE = 5  # chosen: first rows of a topic that may be from before the log
EVEN_SHARE, EVEN_FACTOR = 0.9, 5.0  # chosen: nine of ten steps are within this of the usual one
FEWEST_EVEN = 20  # chosen: rows of a topic that show the clock
FARTHEST_BEHIND_US = 10_000_000  # chosen: a row this far behind the others has a wrong stamp
FARTHEST_US = 1 << 60  # sums and differences of wrong stamps must not overflow


class RowStamps(NamedTuple):
    """Places in the file (n,) of a message's rows, their stamps, and another clock's, in us."""

    at: Stamps
    stamp_us: Stamps | None
    other_us: Stamps | None = None


@dataclass(slots=True)
class RowTimes:
    """The times of rows by message, which of them count, and what was found."""

    clock: "RowClock"
    even: Collection[Any]  # messages that show the clock
    topics: bool  # whether rows have the stamps of their publication
    times: dict[Any, Stamps] = field(default_factory=dict)  # in us, shape (n,)
    # Rows (n,) with a credible stamp.
    keep: dict[Any, NDArray[np.bool_]] = field(default_factory=dict)
    stale: int = 0  # rows from before the log, which count as of its beginning
    begin_us: int = 0
    unstamped: bool = False  # whether rows have no stamp
    misdated: bool = False  # or a wrong one

    def place(self, key: Any, rows: RowStamps) -> tuple[Stamps, NDArray[np.bool_]]:
        """Times (n,) of rows of a message, and whether they are credible."""
        own, clock = _signed(rows.stamp_us), self.clock
        placed, known = clock.between(rows.at), np.zeros(len(rows.at), bool)
        if len(own):
            known = own != 0
            placed = np.where(known, clock.continued(rows.at, own), placed)
        elif not self.unstamped:
            placed = clock.newest_before(rows.at)
        if key in self.even:
            keep = ~known | clock.is_near(rows.at, placed)
        else:
            keep = ~known | (placed <= clock.t_us.max(initial=0) + FARTHEST_BEHIND_US)
            keep &= ~find_misdated(placed, topic=True)
        if self.topics and len(clock.at):
            keep[: _stale_rows(own)] = True
            stale = keep & (placed < self.begin_us - STALE_US)
            self.stale += int(stale.sum())
            placed = np.where(stale, self.begin_us, placed)
        self.misdated |= not keep.all()
        return placed, keep

    def notes(self) -> list[str]:
        """Notes for readers of the report."""
        found = []
        if self.clock.restarts:
            found.append(
                f"the vehicle restarted {self.clock.restarts} time(s) in this log: each boot is "
                "drawn after the one before, one second later"
            )
        if settings := len(self.clock.edges) - self.clock.restarts:
            found.append(f"the log's clock was set {settings} time(s); its rows run on")
        if self.unstamped:
            found.append("rows have no timestamps: they are placed between those that have a time")
        if self.stale:
            found.append(f"{self.stale} samples from before the log are drawn at its beginning")
        return found


def place_rows(
    messages: Mapping[Any, RowStamps], boots: Sequence[int] = (), begin_us: int | None = None
) -> RowTimes:
    """Find the time of every row of a log, by message (and instance).

    `boots` are places in the file at which the logger began anew. `begin_us` is when the log began,
    where rows have the stamps of their publication, which may be long before they are logged: the
    newest sample of every topic is logged first.
    """
    topics = begin_us is not None
    stamps = {key: _signed(rows.stamp_us) for key, rows in messages.items()}
    # By topics that are logged evenly the clock of the others is known.
    even = [key for key, some in stamps.items() if not topics or _is_even(some)] or list(messages)
    parts, unstamped = [], False
    for key in even:
        unstamped |= bool((stamps[key] == 0).any())
        known = stamps[key] != 0
        known[: _stale_rows(stamps[key]) if topics else 0] = False
        parts.append((messages[key].at[: len(known)][known], stamps[key][known]))
    clock = join_clocks(parts, np.sort(np.array(boots, np.int64)))
    clock = _with_other_clock(clock, list(messages.values()))
    first = int(clock.t_us.min()) if len(clock.t_us) else 0
    if begin_us is None or abs(first - begin_us) >= STALE_US:
        begin_us = first
    found = RowTimes(clock, even, topics, begin_us=begin_us, unstamped=unstamped)
    for key, rows in messages.items():
        found.times[key], found.keep[key] = found.place(key, rows)
    return found


def _stale_rows(stamps: Stamps) -> int:
    """How many first rows are from long before the others."""
    steps = np.flatnonzero(np.diff(stamps[:MOST_STALE]) > STALE_US)
    return int(steps[-1]) + 1 if len(steps) else 0


def _is_even(stamps: Stamps) -> bool:
    """Whether a topic is logged at even intervals, and often."""
    if len(stamps) < FEWEST_EVEN:
        return False
    steps = np.abs(np.diff(stamps))
    # Events come in bursts.
    usual = float(np.median(steps))
    return bool(np.quantile(steps, EVEN_SHARE) / EVEN_FACTOR < usual < FREQUENT_US)


def _signed(stamps: Stamps | None) -> Stamps:
    """Stamps as signed numbers: a clock set back before its zero wraps around."""
    if stamps is None:
        return np.empty(0, np.int64)
    return np.clip(stamps.astype(np.int64), -FARTHEST_US, FARTHEST_US)


def _in_file_order(parts: Sequence[tuple[Stamps, Stamps]]) -> tuple[Stamps, Stamps]:
    empty = np.empty(0, np.int64)
    at, t_us = (np.concatenate([empty, *some]) for some in zip(*parts, (empty, empty), strict=True))
    order = np.argsort(at, kind="stable")
    return at[order], t_us[order]


class RowClock(NamedTuple):
    """The vehicle's time along a log."""

    at: Stamps  # places in the log (n,) of rows with a stamp, in order
    t_us: Stamps  # and their times (n,)
    edges: Stamps  # places (k,) from which another clock counts
    shifts: Stamps  # what joins each clock (k + 1,) to the one before, us
    restarts: int  # how many of the edges are restarts of the vehicle

    def continued(self, places: Stamps, stamp_us: Stamps) -> Stamps:
        """The times of stamps (n,) at `places`."""
        return stamp_us + self.shifts[np.searchsorted(self.edges, places, "right")]

    def is_near(self, places: Stamps, t_us: Stamps) -> NDArray[np.bool_]:
        """Whether times (n,) at `places` are about those of the rows before and behind."""
        if not len(self.at):
            return np.ones(len(places), bool)
        behind = np.searchsorted(self.at, places)
        beside = self.t_us[np.clip([behind - 1, behind], 0, len(self.at) - 1)]
        near = (t_us > beside.min(axis=0) - FAR_US) & (t_us < beside.max(axis=0) + FAR_US)
        return np.asarray(near)

    def newest_before(self, places: Stamps) -> Stamps:
        """The time of the row before each of some places (n,)."""
        if not len(self.t_us):
            return np.zeros(len(places), np.int64)
        return self.t_us[np.maximum(np.searchsorted(self.at, places) - 1, 0)]

    def between(self, places: Stamps) -> Stamps:
        """Times (n,) at `places` from known ones; beyond them at the mean rate."""
        at, t_us = self.at, self.t_us
        if len(at) < 2 or at[-1] == at[0]:
            return np.full(len(places), t_us[0] if len(t_us) else 0, np.int64)
        newest = np.maximum.accumulate(t_us)
        inside = np.interp(places, at, newest)
        rate = (newest[-1] - newest[0]) / (at[-1] - at[0])
        beyond = np.minimum(places - at[0], 0) + np.maximum(places - at[-1], 0)
        return np.asarray(inside + rate * beyond, np.int64)


def join_clocks(
    parts: Sequence[tuple[Stamps, Stamps]], boots: Stamps | None, pause_us: int | None = PAUSE_US
) -> RowClock:
    """The clock of rows, given as places and stamps, without those with a wrong stamp.

    `boots` are places at which the logger began anew; None: the vehicle restarts where its clock
    falls back. `pause_us` lies between two boots; None: that between their places, which are times.
    """
    at, t_us = _in_file_order(parts)
    sound = ~find_misdated(t_us)
    at, t_us = at[sound], t_us[sound]
    jumps = np.union1d(find_restarts(t_us), np.flatnonzero(np.diff(t_us) > LONGEST_GAP_US) + 1)
    begins = [0, *jumps.tolist(), len(t_us)]
    shifts, restarts = [0], 0
    for begin, end, after in zip(begins, begins[1:], begins[2:], strict=False):
        newest = int(t_us[begin:end].max()) + shifts[-1]
        restarted = t_us[end] < t_us[end - 1]
        if boots is not None:
            restarted = np.searchsorted(boots, at[end]) > np.searchsorted(boots, at[end - 1])
        # A clock that falls back by less was set.
        restarts += int(restarted and t_us[end] < t_us[end - 1] - FARTHEST_BEHIND_US)
        pause = int(at[end] - at[end - 1]) if pause_us is None else pause_us
        pause = pause if restarted else STEP_US
        join = newest + pause - int(t_us[end:after].min())
        shifts.append(max(-FARTHEST_US, min(join, FARTHEST_US)))
    edges, joins = at[jumps], np.array(shifts, np.int64)
    if boots is not None and len(boots):
        # Rows of a boot that are not given belong to it, too.
        first = boots[np.searchsorted(boots[:-1], at[jumps - 1], "right")]
        edges = np.where((first > at[jumps - 1]) & (first < edges), first, edges)
    t_us = t_us + joins[np.searchsorted(edges, at, "right")]
    return RowClock(at, t_us, edges, joins, restarts)


def _with_other_clock(clock: RowClock, messages: Sequence[RowStamps]) -> RowClock:
    """Add the times of another clock, where a log has no stamps for more than `STALE_US` of it."""
    at, t_us = clock.at, clock.t_us
    others = [(rows.at, rows.other_us) for rows in messages if rows.other_us is not None]
    other_at, other_us = _in_file_order([(a[o > 0], o[o > 0]) for a, o in others])
    if not len(other_at):
        return clock
    order = np.maximum.accumulate(other_us)
    if not len(at):
        return clock._replace(at=other_at, t_us=order - order[0])
    # The stretches without a stamp: gaps between the places that have one.
    inside = (other_at >= at[0]) & (other_at <= at[-1])
    offset = t_us[-1] - np.interp(at[-1], other_at, order) if inside.any() else 0
    behind, before = other_at > at[-1], other_at < at[0]
    lead = t_us[0] - np.interp(at[0], other_at, order)
    times = np.concatenate([order[before] + lead, t_us, order[behind] + offset]).astype(np.int64)
    places = np.concatenate([other_at[before], at, other_at[behind]])
    return clock._replace(at=places, t_us=times)
