"""The engine: runs a schedule on the passing frames, without sockets, clock or files.

All times are microseconds, of vehicle or of link time, which have the same origin: an entry counts
in its own clock, and what leaves is due in link time. Entries act in schedule order, each on the
output of the one before; one that counts in link time acts when that output is due. Only messages
in `wanted` need to pass through the engine; inactive entries cost nothing.
"""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from heapq import heapify, heappop, heappush
from typing import Any

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.proxy.active_entry import ActiveEntry, add_seconds
from mavproxy_fault.proxy.interfaces import ANY, NEVER_US, Route
from mavproxy_fault.schedule.entries import Entry, Schedule, parse_entry
from mavproxy_fault.schedule.saving import write_schedule
from mavproxy_fault.schedule.triggers import Telemetry
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.label import Label

MAX_ENDED_FAULTS = 32  # ended injected faults that a page still shows

Check = Callable[[Sequence[Entry]], None]


def refuse_commands(entries: Sequence[Entry]) -> None:
    """Refuse entries that command the vehicle."""
    for entry in entries:
        if getattr(entry.fault, "commands_vehicle", False):
            raise ConfigError(
                f"{entry.id}: commands the vehicle, which is not allowed; start the proxy "
                "with --allow-commands"
            )


class Engine:
    """Runs a schedule; `revision` changes whenever `wanted` may have changed.

    `check` raises ConfigError for a schedule or an injected fault that is not allowed.
    """

    def __init__(self, schedule: Schedule, *, check: Check | None = None) -> None:
        self._check = check or (lambda entries: None)
        self._check(schedule.faults)
        self.seed = schedule.seed
        self.revision = 0
        self.changes = 0  # counts changes of the active entries
        self.t0_us: int | None = None
        self.now_us = self.link_us = 0
        self.wanted: frozenset[int] | None = frozenset()
        self._schedule = schedule
        self._all: list[ActiveEntry] = []
        self._by_id: dict[int, tuple[ActiveEntry, ...]] = {}
        self._any: tuple[ActiveEntry, ...] = ()
        self._buffering: tuple[ActiveEntry, ...] = ()
        self._watched: dict[int, tuple[ActiveEntry, ...]] = {}
        self._dependents: dict[str, list[tuple[int, ActiveEntry]]] = {}
        self._telemetry = Telemetry()
        self._edges_us = [0, 0]  # next change of an entry, by vehicle time and by link time
        self._labels: list[Label] = []
        self._noted: dict[str, Label] = {}  # open labels of what the vehicle itself does
        self._released: list[Outgoing] = []  # released by a fault that ended
        self._update_wanted()

    @property
    def draws(self) -> bool:
        """Whether an entry may draw random numbers, which requires numpy."""
        return any(
            entry.probability < 1.0
            or getattr(entry.fault, "drawn", getattr(entry.fault, "draws", True))
            or getattr(entry.fault, "profile", None) is not None
            for entry in self._entries()
        )

    # -- time ------------------------------------------------------------------------------------

    def start_at(self, t0_us: int) -> None:
        """Start the schedule at this time, as the first frame does, unless it has started."""
        if self.t0_us is None:
            self.restart(t0_us)

    def restart(self, t0_us: int) -> None:
        """End active faults and start the schedule at this time."""
        for running in [r for r in self._all if r.active]:
            self._end(running, self._now(running))
        entries = list(self._entries())
        self.t0_us = self.now_us = self.link_us = t0_us
        self._all = [self._run(entry, t0_us) for entry in entries]
        self._update_wanted()
        self._advance()

    def _now(self, one: ActiveEntry | Entry) -> int:
        """Return the present time of an entry's clock."""
        entry = one if isinstance(one, Entry) else one.entry
        return self.link_us if entry.clock == "link" else self.now_us

    def _follow(self) -> None:
        """Start and end what is due."""
        if self.now_us >= self._edges_us[0] or self.link_us >= self._edges_us[1]:
            self._advance()

    def _run(self, entry: Entry, base_us: int) -> ActiveEntry:
        assert self.t0_us is not None
        return ActiveEntry(entry, self.seed, base_us, self.t0_us)

    def advance_time(self, t_us: int) -> None:
        """Advance the time for live edits, even without a frame."""
        if self.t0_us is not None:
            self.now_us = max(self.now_us, t_us)
            self.link_us = max(self.link_us, t_us)

    @property
    def release_us(self) -> int | None:
        """Link time at which buffered frames must leave; None without any.

        Now if an edit has ended a fault: its label must not wait for the next frame.
        """
        if self._released or self._labels:
            return self.link_us
        if not self._buffering:  # fast path: called for each frame
            return None
        due_us = min(running.release_us() for running in self._buffering)
        return due_us if due_us < NEVER_US else None

    def due(self, t_us: int) -> list[Outgoing]:
        """Release buffered frames that are due by the link time `t_us`."""
        if self.t0_us is None:
            return []
        self.advance_time(t_us)
        self._follow()
        sends, self._released = self._released, []
        for running in self._buffering:
            if running.release_us() <= t_us:
                sends += running.release(t_us, overdue=True)
        return sends

    def _advance(self) -> None:
        """Start and end entries that are due, including those that depend on them."""
        self._dependents = self._find_dependents()
        due = [(r.next_us, place) for place, r in enumerate(self._all) if r.next_us <= self._now(r)]
        # A heap: after a late start thousands of events may be due, and a linear search for each
        # would stall the forwarding.
        heapify(due)
        while due:
            at_us, place = heappop(due)
            late = self._all[place]
            if late.next_us != at_us:  # rescheduled meanwhile
                continue
            if late.active:
                self._end(late, at_us)
            else:
                late.begin()
                self._start_dependents(late, "start", at_us)
            for further, running in [(place, late), *self._dependents.get(late.entry.id, ())]:
                if running.next_us <= self._now(running):
                    heappush(due, (running.next_us, further))
        self._index()

    def _end(self, running: ActiveEntry, t_us: int) -> None:
        self._released += running.release(t_us, overdue=False)
        label = running.close(t_us)
        if label is not None:
            self._labels.append(label)
        running.end_activation(self._now(running))
        self._start_dependents(running, "end", t_us)

    def _start_dependents(self, leader: ActiveEntry, event: str, t_us: int) -> None:
        """Set the start of the entries that wait for this one's start or end."""
        for _, running in self._dependents.get(leader.entry.id, ()):
            after = running.entry.after
            if after is None or running.starts or running.start_us < NEVER_US:
                continue
            if after.event == event:
                running.start_after_event(add_seconds(t_us, after.delay_s))

    def _find_dependents(self) -> dict[str, list[tuple[int, ActiveEntry]]]:
        """Return the entries that wait for another one, with their indices, by its id."""
        dependents: dict[str, list[tuple[int, ActiveEntry]]] = {}
        for place, running in enumerate(self._all):
            if running.entry.after is not None:
                dependents.setdefault(running.entry.after.id, []).append((place, running))
        return dependents

    def _index(self) -> None:
        """Update the tables of active entries by message, and the time of the next change."""
        self.changes += 1
        active = [running for running in self._all if running.active]
        ids = {number for running in active for number in running.entry.ids or ()}
        self._dependents = self._find_dependents()
        self._any = tuple(r for r in active if r.entry.ids is None)
        self._buffering = tuple(r for r in active if r.buffers)
        self._by_id = {
            number: tuple(r for r in active if r.entry.ids is None or number in r.entry.ids)
            for number in ids
        }
        for clock in (0, 1):
            times = (running.next_us for running in self._all if running.on_link == clock)
            self._edges_us[clock] = min(times, default=NEVER_US)

    def _update_wanted(self) -> None:
        """Update `wanted` and the conditions' messages after an edit."""
        self.revision += 1
        ids: set[int] = set()
        everything = self.t0_us is None  # the first frame of any kind sets the time
        for entry in self._entries():
            everything |= entry.ids is None
            ids |= entry.ids or set()
            for condition in (entry.condition, entry.moment):
                ids |= condition.ids if condition is not None else set()
        self.wanted = None if everything else frozenset(ids)
        self._watched = {
            number: tuple(r for r in self._all if number in r.watched_ids)
            for number in {n for r in self._all for n in r.watched_ids}
        }
        self._index()

    @property
    def interrupted(self) -> dict[int, Any]:
        """What active faults do to connections, by the links (a bit mask)."""
        found: dict[int, Any] = {}
        for running in self._all:
            how = getattr(running.fault, "connection", "kept") if running.active else "kept"
            if how != "kept" and (running.frames or not getattr(running.fault, "after_bytes", 0)):
                found[running.endpoint_links] = how
        return found

    @property
    def edges_us(self) -> tuple[int, int]:
        """Times from which frames have to be seen: of the next scheduled start or end, by vehicle
        time and by link time.

        With the labels of a live edit waiting, the next frame announces them.
        """
        waiting = self._labels or self._released
        return -NEVER_US if waiting else self._edges_us[0], self._edges_us[1]

    def active_entries(self, number: int) -> tuple[ActiveEntry, ...] | None:
        """Return the entries active on a message; None if a condition reads it."""
        return None if number in self._watched else self._by_id.get(number, self._any)

    # -- bytes -----------------------------------------------------------------------------------

    def apply(
        self, frame: Frame, direction: str, t_us: int, route: Route = ANY, *, sealed: bool = False
    ) -> list[Outgoing]:
        """Process a frame; an unchanged one is returned as the same object, due at its link time.

        With `sealed` (signed with an unknown key) value faults skip the frame and count it.
        """
        if self.t0_us is None:
            self.start_at(t_us)
        self.now_us, self.link_us = t_us, t_us if route.link_us is None else route.link_us
        if frame.id in self._watched:
            self._watch(frame)
        self._follow()
        chosen = self._by_id.get(frame.id, self._any)
        acting = [one for one in chosen if one.admits(frame, direction, sealed=sealed)]
        sends = self._act(acting, frame, direction, t_us, route)
        if self._released:
            sends, self._released = self._released + sends, []
        return sends

    def _act(
        self,
        acting: Sequence[ActiveEntry],
        data: Frame | bytes,
        direction: str,
        t_us: int,
        route: Route,
    ) -> list[Outgoing]:
        """Let entries act in turn, and attend to their labels."""
        sends = [Outgoing(self.link_us, data)]
        for running in acting:
            sends = _apply_to_outgoing(running, sends, direction, t_us, route)
            if running.needs_attention:
                self.attend(running, self._now(running))
        return sends

    def attend(self, running: ActiveEntry, t_us: int) -> None:
        """Add a pending label of a fault, at a time of its clock, and note an early end."""
        clock = running.on_link
        self._edges_us[clock] = min(self._edges_us[clock], running.end_us)
        news = running.pending_label(t_us)
        if news is not None:
            self._labels.append(news)

    def attend_begun(self) -> None:
        """Attend to the entries that have changed a first frame outside of the core."""
        for running in self._all:
            if running.first_us is not None and running.label_us == -NEVER_US:
                self.attend(running, running.first_us)

    def _watch(self, frame: Frame) -> None:
        """Check the conditions against a frame as received, before any fault acts on it."""
        self._telemetry.note(frame)
        for running in self._watched[frame.id]:
            t_us = self._now(running)
            if running.check_condition(t_us, self._telemetry):
                self._edges_us[running.on_link] = t_us

    def junk(
        self, data: bytes | Frame, direction: str, t_us: int, route: Route, *, sealed: bool = False
    ) -> list[Outgoing]:
        """Process bytes that are not a frame, or a frame of an unknown message.

        Faults on an entire link act on both, and faults on a sender on the frame. With `sealed`
        it is signed with an unknown key.
        """
        link_us = t_us if route.link_us is None else route.link_us
        if self.t0_us is None:
            return [Outgoing(link_us, data)]
        self.now_us, self.link_us = t_us, link_us
        self._follow()
        acting = [one for one in self._any if one.admits_junk(data, direction, sealed=sealed)]
        return self._act(acting, data, direction, t_us, route)

    def drain_labels(self) -> list[Label]:
        """Return the labels written since the last call."""
        labels, self._labels = self._labels, []
        return labels

    def note_label(self, label: Label) -> None:
        """Begin the label of a failure that the vehicle itself carries out."""
        self._noted[label.id] = label
        self._labels.append(label)

    def end_noted(self, id: str, t_us: int, *, parts: bool = True) -> None:
        """End such a label, with `parts` also those whose id continues with a hyphen."""
        for name in [
            one for one in self._noted if one == id or (parts and one.startswith(id + "-"))
        ]:
            label = self._noted.pop(name)
            self._labels.append(msgspec.structs.replace(label, end_us=max(t_us, label.start_us)))

    def finish(self, t_us: int) -> list[Label]:
        """End all faults and return the last labels; call `due` next for buffered frames."""
        for id in list(self._noted):
            self.end_noted(id, t_us)
        if self.t0_us is not None:
            self.now_us, self.link_us = t_us, max(self.link_us, t_us)
            self._advance()
        for running in [r for r in self._all if r.active]:
            self._end(running, self._now(running))
            running.start_us = running.end_us = NEVER_US
        self._index()
        return self.drain_labels()

    # -- live edits ------------------------------------------------------------------------------

    def arm(self, entry: Entry | Sequence[Entry] | dict[str, Any]) -> list[str]:
        """Add a fault, or replace the one of the same id; its `at_s` counts from now.

        Returns
        -------
        list of str
            The ids, several if a preset has several parts.

        Raises
        ------
        ConfigError
            If a mapping is not a valid entry.
        """
        if isinstance(entry, dict):
            entry = parse_entry(entry, "arm")
        entries = [entry] if isinstance(entry, Entry) else entry
        self._check(entries)
        if self.t0_us is None:
            ids = {one.id for one in entries}
            kept = [one for one in self._schedule.faults if one.id not in ids]
            self._schedule = Schedule(self.seed, (*kept, *entries))
        else:
            for one in entries:
                self._remove({one.id})
                running = ActiveEntry(one, self.seed, self._now(one), self.t0_us, injected=True)
                self._all.append(running)
            self._advance()
            # Ended ones are removed, except the latest, which a page may show.
            ended = [running for running in self._all if running.injected and running.done]
            for running in ended[:-MAX_ENDED_FAULTS]:
                self._all.remove(running)
        self._update_wanted()
        return [one.id for one in entries]

    def clear(self, id: str) -> bool:
        """End and remove a fault with its parts, or `all`; return whether there was one."""
        ids = {one.id for one in self._entries() if _is_fault_or_part(one.id, id)}
        self._remove(ids)
        kept = tuple(one for one in self._schedule.faults if one.id not in ids)
        self._schedule = msgspec.structs.replace(self._schedule, faults=kept)
        self._update_wanted()
        return bool(ids)

    def _remove(self, ids: Container[str]) -> None:
        for running in self._all:
            if running.active and running.entry.id in ids:
                self._end(running, self._now(running))
        self._all = [running for running in self._all if running.entry.id not in ids]

    def update(self, id: str, value: float, latency_us: int | None = None) -> None:
        """Set another value of a fault, or the newest streamed value of a live profile.

        `latency_us` is the age of the value by the wall clock, if known.

        Raises
        ------
        ConfigError
            If there is no such fault, or it has no value.
        """
        chosen = [running for running in self._all if running.entry.id == id]
        if not chosen:
            if id in self.ids():
                raise ConfigError(f"update: {id} waits for the vehicle's first timestamp")
            raise ConfigError(f"update: {id} is not a fault; {suggest_known(id, self.ids())}")
        chosen[0].set_value(value, self._now(chosen[0]), latency_us)
        self._update_wanted()

    def prepare_entries(self, schedule: Schedule) -> dict[str, ActiveEntry]:
        """Create the active entries for `replace`, by id; read-only, so any thread may call it."""
        t0_us = self.t0_us
        if t0_us is None:
            return {}
        prepared = {entry.id: self._run(entry, t0_us) for entry in schedule.faults}
        followed = {entry.after.id for entry in schedule.faults if entry.after is not None}
        for running in prepared.values():
            # Mark entries that are over as done, to save the forwarding loop the work.
            over = running.end_us <= self._now(running) and running.entry.repeat is None
            if over and running.entry.id not in followed:
                running.begin()
                running.end_activation(self._now(running))
            running.state()  # cached, as a page reads it next
        return prepared

    def replace(
        self,
        schedule: Schedule,
        *,
        anew: bool = False,
        prepared: Mapping[str, ActiveEntry] | None = None,
    ) -> Sequence[ActiveEntry]:
        """Replace the schedule; entries that are the same in both continue undisturbed.

        With `anew` times count from now instead of the start, and every entry restarts. Returns
        the old entries, because freeing a thousand would take milliseconds here.
        """
        before = self._all
        self._check(schedule.faults)
        self._schedule = schedule
        if self.t0_us is not None:
            wanted = {} if anew else {entry.id: entry for entry in schedule.faults}
            going: dict[str, ActiveEntry] = {}
            for running in self._all:
                entry = wanted.get(running.entry.id)
                if entry and _comparable_entry(
                    running.entry, self._late_s(running)
                ) == _comparable_entry(entry):
                    going[entry.id] = running
                elif running.active:
                    self._end(running, self._now(running))
            # Unusable if the schedule has restarted since, or its times count from now.
            fresh = {
                id: running
                for id, running in (prepared or {}).items()
                if running.t0_us == self.t0_us and not anew
            }
            self._all = [
                going.get(entry.id)
                or fresh.get(entry.id)
                or self._run(entry, self._now(entry) if anew else self.t0_us)
                for entry in schedule.faults
            ]
            self._advance()
        self._update_wanted()
        return before

    # -- state -----------------------------------------------------------------------------------

    def _entries(self) -> Iterable[Entry]:
        if self.t0_us is None:
            return self._schedule.faults
        return [running.entry for running in self._all]

    def ids(self) -> list[str]:
        """Return the ids of all faults, waiting, active or done."""
        return [entry.id for entry in self._entries()]

    @property
    def active(self) -> list[str]:
        """The ids of the active faults."""
        return [running.entry.id for running in self._all if running.active]

    def state(self) -> dict[str, Any]:
        """Return the state of the schedule and every fault, for pages and the bus."""
        return {
            "t0_us": self.t0_us,
            "now_us": self.now_us,
            "seed": self.seed,
            "revision": self.revision,
            "faults": [running.state() for running in self._all]
            if self.t0_us is not None
            else [{"id": one.id, "fault": one.name, "state": "waiting"} for one in self._entries()],
        }

    def save(self, *, anew: bool = False) -> str:
        """Return the present schedule, live edits included, as YAML for `read_schedule`.

        Times count from the start, or with `anew` from when the first entry was loaded.
        """
        if self.t0_us is None:
            return write_schedule(self.seed, [(entry, 0.0) for entry in self._schedule.faults])
        late_s = [self._late_s(running) for running in self._all]
        first_s = min(late_s, default=0.0) if anew else 0.0
        late = zip(self._entries(), (one_s - first_s for one_s in late_s), strict=True)
        return write_schedule(self.seed, late)

    def _late_s(self, running: ActiveEntry) -> float:
        """Return the seconds from the start to the time from which an entry's times count."""
        assert self.t0_us is not None
        return (running.base_us - self.t0_us) * 1e-6


def _comparable_entry(entry: Entry, late_s: float = 0.0) -> Entry:
    """Normalize an entry for comparison: times from the start, source text removed."""
    # Rounded as in a saved file, so that a saved and reloaded entry is equal.
    return msgspec.structs.replace(entry, at_s=round(late_s + entry.at_s, 6), written={})


def _is_fault_or_part(id: str, chosen: str) -> bool:
    """Whether a fault's id is the chosen id, or that of one of its parts, such as `id.2`."""
    head, _, part = id.rpartition(".")
    return chosen == "all" or id == chosen or (head == chosen and part.isdigit())


def _apply_to_outgoing(
    running: ActiveEntry, sends: list[Outgoing], direction: str, t_us: int, route: Route
) -> list[Outgoing]:
    """Apply an entry to the output of the earlier ones; delays add up."""
    outgoing: list[Outgoing] = []
    towards = -1 if running.endpoint_links & route.come else running.endpoint_links
    for out in sends:
        frame = out.frame
        if out.back or (isinstance(frame, bytes) and not running.takes_bytes):
            outgoing.append(out)
            continue
        if towards != -1:  # what goes to one endpoint, apart from what goes to the others
            others = out.links & ~towards & route.go
            if others:
                outgoing.append(msgspec.structs.replace(out, links=others))
            if not out.links & towards & route.go:
                continue
            out = msgspec.structs.replace(out, links=out.links & towards)
        own_us = out.due_us if running.on_link else t_us
        for further in running.act(frame, direction, own_us):
            if further.frame is frame and further.due_us == own_us:
                outgoing.append(out)
                continue
            # What a link reports (RADIO_STATUS) goes back to where its frame came from, only.
            links = route.come if further.back and running.on_link else out.links
            # Copied only if the clocks differ, an earlier entry delayed it, or for some links only.
            if out.due_us != own_us or links != -1:
                due_us = further.due_us + out.due_us - own_us
                further = msgspec.structs.replace(further, due_us=due_us, links=links)
            outgoing.append(further)
    return outgoing
