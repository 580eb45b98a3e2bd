"""One entry of a running schedule: when it is active, what it changed, and its labels."""

import logging
import math
from typing import TYPE_CHECKING, Any, cast, get_type_hints
from zlib import crc32

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.fault_parts import hits
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.fault_parts.memory import Memory
from mavproxy_fault.proxy.interfaces import NEVER_US
from mavproxy_fault.proxy.sender_rules import is_selected
from mavproxy_fault.schedule.entries import Entry
from mavproxy_fault.schedule.triggers import Telemetry
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.label import Label

if TYPE_CHECKING:
    from numpy.random import Generator

LOG = logging.getLogger(__name__)
DIRECTIONS = "", "to-vehicle", "from-vehicle", "both"  # of an activation, by bit mask
WAYS = DIRECTIONS[1:3]
ANY = -1  # of `where`
VALUE_LABEL_INTERVAL_US = 200_000  # between two labels of new values: a slider moves faster


def add_seconds(t_us: int, seconds: float) -> int:
    """Add seconds to a timestamp; NEVER_US if no clock reaches it."""
    # Never reached: infinite durations and timestamps near the 64-bit limit.
    later_us = t_us + seconds * 1e6
    return t_us + round(seconds * 1e6) if later_us < NEVER_US else NEVER_US


class LazyGenerator:
    """A random number generator that loads numpy at the first draw."""

    def __init__(self, seed: int, name: str) -> None:
        self._seeds = [seed, crc32(name.encode())]

    def __getattr__(self, name: str) -> Any:
        from numpy.random import default_rng

        generator = self.__dict__.get("_generator") or default_rng(self._seeds)
        self._generator = generator
        method = getattr(generator, name)
        setattr(self, name, method)  # later draws bypass __getattr__
        return method


class ActiveEntry:
    """A schedule entry with its fault's state and its counts.

    All its times are of its own clock: link time if `on_link`, else vehicle time. `base_us` is that
    from which `at_s` counts. An `injected` entry (live edit) is not in the schedule and is removed
    some time after it ended.
    """

    def __init__(
        self, entry: Entry, seed: int, base_us: int, t0_us: int, *, injected: bool = False
    ) -> None:
        self.entry = entry
        self.injected = injected
        self.fault: Any = entry.fault
        self.seed = seed
        self.t0_us = t0_us
        self.base_us = base_us
        self.condition = entry.condition
        self.armed = True  # a condition starts the fault only when it becomes true
        self.earliest_us = add_seconds(base_us, entry.at_s)
        # A condition is checked only after the event that the entry waits for.
        self._waits_for_event = entry.after is not None or entry.moment is not None
        self.start_us = NEVER_US if entry.when or self._waits_for_event else self.earliest_us
        self.end_us = self._end()
        self.active = False
        self.starts = 0
        self.counts = Memory(hits.COUNTS)
        self._earlier_frames = 0  # of earlier activations
        self.failures = 0  # frames on which the fault raised an error
        self.failure: str | None = None
        self.needs_attention = False  # for the engine: a first frame, a new value, or an early end
        self.states: dict[str, Any] = {}
        self.rng = cast("Generator", LazyGenerator(seed, entry.id))
        self.chance_rng = cast("Generator", LazyGenerator(seed, entry.id + " probability"))
        self.live: tuple[float, int] | None = None  # newest streamed value and its time
        self.latency_us: int | None = None
        self.value: float | None = None  # set by a live edit, constant or streamed
        self.changed_us: int | None = None
        self.unannounced = False  # no label has the newest value yet
        self._announced_us: int | None = None  # None: the activation has no label yet
        self._described: tuple[Any, ...] = ()
        self._description: dict[str, Any] = {}
        where = entry.where
        way = None if where.direction is None else WAYS.index(where.direction)
        numbers = (where.system, where.component, way, where.id)
        self.where: Any = tuple(ANY if one is None else one for one in numbers)  # `is_selected`
        self.endpoint_links = -1 if where.endpoint is None else 1 << where.endpoint  # a bit mask
        self.on_link = entry.clock == "link"
        self.matches_all = self.where == (ANY, ANY, ANY, ANY)
        self.takes_bytes = entry.ids is None and getattr(entry.fault, "takes_bytes", False)
        self.takes_unknown = entry.ids is None and getattr(
            entry.fault, "takes_unknown", self.takes_bytes
        )
        self.takes_sealed = getattr(entry.fault, "takes_sealed", False)
        self.buffers = hasattr(entry.fault, "release_us")
        self._releases = hasattr(entry.fault, "release")
        self.ends_itself = hasattr(entry.fault, "done")
        self.keeps_back = getattr(entry.fault, "keeps_back", False)
        codes = {e.code for row in getattr(entry.fault, "elements", {}).values() for e in row}
        self._whole = bool(codes) and not codes & {"f", "d"}

    @property
    def magnitude(self) -> float | None:
        """The largest change of the present activation."""
        largest = self.counts.numbers[hits.LARGEST]
        if not self.frames or largest < 0.0:
            return None
        return int(largest) if self._whole else largest  # a change of integers is an integer

    @property
    def frames(self) -> int:
        """Frames changed in the present activation."""
        return int(self.counts.numbers[hits.FRAMES])

    @property
    def first_us(self) -> int | None:
        """Time of the first changed frame of the present activation."""
        return int(self.counts.numbers[hits.FIRST_US]) if self.frames else None

    @property
    def total_frames(self) -> int:
        """Frames changed in all activations."""
        return self._earlier_frames + self.frames

    @property
    def watched_ids(self) -> set[int]:
        """Ids of the messages that its conditions read."""
        conditions = (self.condition, self.entry.moment)
        return {number for one in conditions if one is not None for number in one.ids}

    def _end(self) -> int:
        for_s = self.entry.for_s
        return NEVER_US if for_s is None or self.start_us == NEVER_US else add_seconds(
            self.start_us, for_s
        )  # fmt: skip

    def trigger(self, t_us: int) -> None:
        """Set the start to `t_us`, because the condition or event has occurred."""
        self.start_us = t_us
        self.end_us = self._end()

    def start_after_event(self, t_us: int) -> None:
        """The awaited event has occurred: start at `t_us`, or check the condition from then on."""
        if not self._waits_for_event:
            return
        self._waits_for_event = False
        self.earliest_us = max(t_us, self.earliest_us)
        if self.condition is None:
            self.trigger(self.earliest_us)

    def check_condition(self, t_us: int, telemetry: Telemetry) -> bool:
        """Start if the condition has become true or the flight event has occurred; True if so."""
        moment = self.entry.moment
        if moment is not None and self._waits_for_event and moment.holds(telemetry):
            self.start_after_event(add_seconds(t_us, self.entry.at_s))
            return True
        # An active or already triggered entry is not started again.
        if (
            self.active
            or self.condition is None
            or self._waits_for_event
            or t_us < self.earliest_us
        ):
            return False
        if self.start_us < NEVER_US or not self._may_start_again():
            return False
        # Re-arm while it is false: becoming true again is a new start.
        if not self.condition.holds(telemetry):
            self.armed = True
            return False
        if not self.armed:
            return False
        self.armed = False
        self.trigger(t_us)
        return True

    def _may_start_again(self) -> bool:
        repeat = self.entry.repeat
        if not self.starts:
            return True
        if repeat is None or repeat.every_s is not None:
            return False
        return repeat.times is None or self.starts < repeat.times

    def begin(self) -> None:
        """Begin an activation; every direction gets a new state."""
        self.active = True
        self.starts += 1
        self.states = {}

    def end_activation(self, now_us: int) -> None:
        """End an activation; set the next start if the entry repeats, skipping missed ones."""
        self.active = False
        repeat = self.entry.repeat
        if repeat is not None and repeat.every_s is not None:
            # A time jump may skip entire repetitions: they count, but without any effect.
            missed = int((now_us - self.start_us) * 1e-6 / repeat.every_s) - 1
            self.starts += max(missed, 0)
            if repeat.times is None or self.starts < repeat.times:
                next_us = add_seconds(self.start_us, repeat.every_s * (1 + max(missed, 0)))
                self.start_us = max(next_us, self.start_us + 1)  # it must advance
                self.end_us = self._end()
                return
        self.start_us = self.end_us = NEVER_US

    @property
    def next_us(self) -> int:
        """Time of its next scheduled start or end."""
        return self.end_us if self.active else self.start_us

    @property
    def done(self) -> bool:
        """Whether it has been active and has no further scheduled start."""
        return not self.active and self.start_us == NEVER_US and self.starts > 0

    def admits(self, frame: Frame, direction: str, *, sealed: bool) -> bool:
        """Whether the fault acts on a frame; a sealed one that it cannot change is counted."""
        if not self.matches_all:
            instance = self._instance(frame) if self.where[3] >= 0 else ANY
            sender = frame.system << 8 | frame.component
            if not is_selected(self.where, sender, WAYS.index(direction), instance):
                return False
        if sealed and not self.takes_sealed:
            self.counts.numbers[hits.SEALED] += 1.0
            return False
        return True

    @staticmethod
    def _instance(frame: Frame) -> int:
        found = frame.read(frame.layout.instance) if frame.layout.instance else 0
        return found if isinstance(found, int) else ANY

    def admits_junk(self, data: bytes | Frame, direction: str, *, sealed: bool) -> bool:
        """Whether the fault acts on junk, or on a frame of an unknown message."""
        system, component, way, instance = self.where
        if isinstance(data, bytes):
            # They have no sender that a filter could match.
            anything = system == component == instance == ANY
            return self.takes_bytes and anything and way in (ANY, WAYS.index(direction))
        # The instance is in the payload, which cannot be read.
        readable = self.takes_unknown and instance == ANY
        return readable and self.admits(data, direction, sealed=sealed)

    def act(self, frame: Frame | bytes, direction: str, t_us: int) -> list[Outgoing]:
        """Apply the fault to a frame and count the effect."""
        chance = self.entry.probability
        if chance < 1.0 and self.chance_rng.random() >= chance:
            return [Outgoing(t_us, frame)]
        try:
            sends = self._apply(frame, direction, t_us)
        except Exception as error:  # a failing plugin fault must not stop the forwarding
            self.note_failure(error)
            return [Outgoing(t_us, frame)]
        # Unchanged and on time: no effect.
        if len(sends) == 1 and sends[0].frame is frame and sends[0].due_us == t_us:
            return sends
        # Of buffered frames only those with a magnitude were changed.
        touched = sum(out.magnitude is not None for out in sends) if self.keeps_back else 1
        if touched:
            self.needs_attention |= not self.frames
            sizes = [out.magnitude for out in sends if out.magnitude is not None]
            largest = max((size for size in sizes if math.isfinite(size)), default=-1.0)
            saturated, way = sum(out.saturated for out in sends), DIRECTIONS.index(direction) - 1
            hits.note_hits(self.counts.numbers, t_us, way, touched, saturated, largest)
        return sends

    def note_failure(self, error: Exception) -> None:
        """Count a frame forwarded unchanged because the fault failed; log the first."""
        if not self.failures:
            LOG.exception("fault %s failed; its frames are forwarded unchanged", self.entry.id)
        self.failures += 1
        self.failure = repr(error)

    def _apply(self, frame: Frame | bytes, direction: str, t_us: int) -> list[Outgoing]:
        """Apply the fault to a frame and update its state for that direction."""
        state = self.states.get(direction)
        if state is None and direction not in self.states:
            state = self.fault.new_state(self.start_us)
            if self.live is not None:  # with the newest streamed value
                state = self.fault.fed(state, *self.live)
            self.states[direction] = state
        sends: list[Outgoing]
        sends, state = self.fault.apply(frame, t_us, state, self.rng)
        self.states[direction] = state
        if self.ends_itself and self.fault.done(state):
            self.end_us, self.needs_attention = t_us, True  # before the scheduled time
        return sends

    def release_us(self) -> int:
        """Time at which a fault that buffers frames must release the oldest."""
        times = [self.fault.release_us(state) for state in self.states.values()]
        return min((time for time in times if time is not None), default=NEVER_US)

    def release(self, t_us: int, *, overdue: bool) -> list[Outgoing]:
        """Release what the fault keeps: all, or the buffered frames of directions overdue."""
        sends: list[Outgoing] = []
        for direction, state in self.states.items() if self._releases else ():
            until_us = self.fault.release_us(state) if overdue else t_us
            if until_us is not None and until_us <= t_us:
                released, self.states[direction] = self.fault.release(t_us, state)
                sends += released
        return sends

    def label(self, end_us: int | None) -> Label:
        """Create the label of the present activation, open (`end_us` None) or complete."""
        entry = self.entry
        where = {
            key: value
            for key in ("system", "component", "id", "direction", "endpoint")
            if (value := getattr(entry.where, key)) is not None
        }
        return Label(
            id=entry.id,
            fault=entry.name,
            preset=entry.preset,
            targets=entry.targets,
            direction=DIRECTIONS[int(self.counts.numbers[hits.WAYS])],
            t0_us=self.t0_us,
            start_us=self.first_us or 0,
            end_us=end_us,
            frames=self.frames,
            magnitude=self.magnitude,
            saturated=int(self.counts.numbers[hits.SATURATED]),
            where=where,
            parameters=entry.parameters,
            seed=self.seed,
            value=self.value,
            changed_us=self.changed_us,
            clock="link" if self.on_link else "",
        )

    @property
    def label_us(self) -> int:
        """Time at which its next label is due, NEVER_US for none; the first is always due."""
        if self._announced_us is None:
            return -NEVER_US
        # A slider changes the value many times a second: limit the rate of labels.
        return self._announced_us + VALUE_LABEL_INTERVAL_US if self.unannounced else NEVER_US

    def pending_label(self, t_us: int) -> Label | None:
        """Return a label for the activation's first changed frame or a new value, if due."""
        if self.first_us is None or t_us < self.label_us:
            return None
        if self._announced_us is None:
            self.changed_us = None  # a value set earlier is the initial value
        self.unannounced = self.needs_attention = False
        self._announced_us = t_us
        return self.label(None)

    def close(self, t_us: int) -> Label | None:
        """Return the complete label of the ended activation (None without effect); reset counts."""
        # The frame that ends an activation may have an older time than its first frame, for example
        # a reply without a timestamp.
        label = None if self.first_us is None else self.label(max(t_us, self.first_us))
        self._earlier_frames += self.frames
        self.counts.write([0.0] * hits.SEALED)
        self.changed_us = self._announced_us = None
        return label

    def set_value(self, value: float, t_us: int, latency_us: int | None) -> None:
        """Set a streamed value, or another constant one.

        Raises
        ------
        ConfigError
            If the fault has no value.
        """
        inner = getattr(self.fault, "fault", self.fault)  # satellite faults are wrapped
        profile = getattr(inner, "profile", None)
        if profile is not None and profile.live is not None:
            self._stream(value, t_us, latency_us, profile.live.timeout_s)
        else:
            self._change(inner, value)
        # Only a different value needs a label.
        if value != self.value:
            self.value, self.changed_us, self.unannounced = value, t_us, True
            self.needs_attention = True

    def _change(self, inner: Any, value: float) -> None:
        """Set another constant value."""
        if getattr(inner, "value", None) is None:
            raise ConfigError(
                f"update: {self.entry.id} ({self.entry.name}) has no value to change; "
                "clear it and arm another"
            )
        try:
            hints = get_type_hints(type(inner), include_extras=True)
            changed = msgspec.structs.replace(inner, value=msgspec.convert(value, hints["value"]))
        except (ValueError, msgspec.ValidationError) as error:
            # Live changes obey the value's limits too.
            raise ConfigError(f"update: {self.entry.id} = {value}: {error}") from None
        wrapped = inner is not self.fault
        self.fault = msgspec.structs.replace(self.fault, fault=changed) if wrapped else changed
        written = {**self.entry.written, "value": value}
        self.entry = msgspec.structs.replace(self.entry, fault=self.fault, written=written)

    def _stream(self, value: float, t_us: int, latency_us: int | None, timeout_s: float) -> None:
        if latency_us is not None:
            self.latency_us = latency_us
            # A stale value must not act on a vehicle.
            if latency_us > timeout_s * 1e6:
                raise ConfigError(
                    f"update: {self.entry.id} = {value} is {latency_us / 1e6:.3f} s old; "
                    f"values older than {timeout_s} s are refused"
                )
        self.live = (value, t_us)
        for direction, state in self.states.items():
            self.states[direction] = self.fault.fed(state, value, t_us)

    def state(self) -> dict[str, Any]:
        """Return its state for pages and the bus; the same object while unchanged."""
        now = (
            self.active, self.starts, self.start_us, self.end_us, self.total_frames, self.magnitude,
            *self.counts.numbers, self.failures, self.latency_us, self.value,
        )  # fmt: skip
        # Nearly all of a thousand entries wait: describing them again would delay frames.
        if now != self._described:
            self._described, self._description = now, self._describe()
        return self._description

    def _describe(self) -> dict[str, Any]:
        phase = "active" if self.active else "done" if self.done else "waiting"
        return {
            "id": self.entry.id,
            "fault": self.entry.name,
            "preset": self.entry.preset,
            "targets": list(self.entry.targets),
            "state": phase,
            "start_us": self.start_us if self.start_us < NEVER_US else None,
            "end_us": self.end_us if self.end_us < NEVER_US else None,
            "frames": self.total_frames,
            "magnitude": self.magnitude,
            "saturated": int(self.counts.numbers[hits.SATURATED]),
            "signed_skipped": int(self.counts.numbers[hits.SEALED]),
            "failures": self.failures,
            "failure": self.failure,
            "latency_us": self.latency_us,
            "value": self.value,
            "parameters": self.entry.parameters,
        }
