"""One entry of a schedule at work: when it is active, what it did, and the labels for it."""

import logging
import math
from typing import TYPE_CHECKING, Any, cast, get_type_hints
from zlib import crc32

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.schedule.entries import Entry
from mavproxy_fault.schedule.triggers import Telemetry
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.label import Label

if TYPE_CHECKING:
    from numpy.random import Generator

LOG = logging.getLogger(__name__)
BOTH_DIRECTIONS = "both"  # directions of one stretch
NEVER_US = 1 << 62
VALUE_LABEL_INTERVAL_US = 200_000  # between two labels about new values of one fault


def add_seconds(t_us: int, seconds: float) -> int:
    """A stamp so many seconds later; NEVER_US where no clock gets there."""
    # Infinite durations and stamps near the end of 64 bits are never reached.
    later_us = t_us + seconds * 1e6
    return t_us + round(seconds * 1e6) if later_us < NEVER_US else NEVER_US


class LazyGenerator:
    """A generator of random numbers that loads numpy when it is first drawn from."""

    def __init__(self, seed: int, name: str) -> None:
        self._seeds = [seed, crc32(name.encode())]

    def __getattr__(self, name: str) -> Any:
        from numpy.random import default_rng

        generator = self.__dict__.get("_generator") or default_rng(self._seeds)
        self._generator = generator
        found = getattr(generator, name)
        setattr(self, name, found)  # asked for once: the next draw costs nothing here
        return found


class ActiveEntry:
    """An entry, the state of its fault, and the count of what it did.

    `base_us` is the stamp from which `at_s` counts; an `injected` entry stands in no schedule, and
    is forgotten some time after it ended.
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
        self.armed = True  # a condition starts the fault when it becomes true, not while it is
        self.earliest_us = add_seconds(base_us, entry.at_s)
        # With a condition too, that counts from the event or moment on.
        self._waits_for_event = entry.after is not None or entry.moment is not None
        self.start_us = NEVER_US if entry.when or self._waits_for_event else self.earliest_us
        self.end_us = self._end()
        self.active = False
        self.starts = 0
        self.frames = self.sealed = self.saturated = 0
        self._earlier_frames = 0  # of the stretches that have ended
        self.failures = 0  # frames that the fault could not be applied to
        self.failure: str | None = None
        self._largest = -1.0  # change of the present stretch; negative: none that has a size
        self.first_us: int | None = None
        self.needs_attention = (
            False  # the engine has to look: a first frame, a new value, an end of itself
        )
        self.direction = ""
        self.states: dict[str, Any] = {}
        self.rng = cast("Generator", LazyGenerator(seed, entry.id))
        self.live: tuple[float, int] | None = None  # newest streamed value and when it came
        self.latency_us: int | None = None
        self.value: float | None = None  # given live, constant or streamed
        self.changed_us: int | None = None
        self.unannounced = False  # no label has told the newest value
        self._announced_us: int | None = None  # None: the stretch has no label yet
        self._described: tuple[Any, ...] = ()
        self._description: dict[str, Any] = {}
        where = entry.where
        # In a tuple: read for each frame that passes.
        self._where = (where.system, where.component, where.direction, where.id)
        self.matches_all = self._where == (None, None, None, None)
        self.takes_bytes = entry.ids is None and getattr(entry.fault, "takes_bytes", False)
        self.takes_sealed = getattr(entry.fault, "takes_sealed", False)
        self.buffers = hasattr(entry.fault, "release")  # `Buffering`; asking for that is slow
        self.ends_itself = hasattr(entry.fault, "done")
        self.keeps_back = getattr(entry.fault, "keeps_back", False)

    @property
    def magnitude(self) -> float | None:
        """The largest change of the present stretch."""
        return self._largest if self._largest >= 0.0 else None

    @property
    def total_frames(self) -> int:
        """Frames that all its stretches have touched."""
        return self._earlier_frames + self.frames

    @property
    def watched_ids(self) -> set[int]:
        """The messages that it looks at besides those it acts on."""
        conditions = (self.condition, self.entry.moment)
        return {number for one in conditions if one is not None for number in one.ids}

    def _end(self) -> int:
        for_s = self.entry.for_s
        return NEVER_US if for_s is None or self.start_us == NEVER_US else add_seconds(
            self.start_us, for_s
        )  # fmt: skip

    def trigger(self, t_us: int) -> None:
        """Start at `t_us`, because what it waited for has come."""
        self.start_us = t_us
        self.end_us = self._end()

    def start_after_event(self, t_us: int) -> None:
        """The event that it waited for has come: start at `t_us`, or look at the condition from
        then on."""
        if not self._waits_for_event:
            return
        self._waits_for_event = False
        self.earliest_us = max(t_us, self.earliest_us)
        if self.condition is None:
            self.trigger(self.earliest_us)

    def check_condition(self, t_us: int, telemetry: Telemetry) -> bool:
        """Start if the condition has become true, or note the moment; whether it did."""
        moment = self.entry.moment
        if moment is not None and self._waits_for_event and moment.holds(telemetry):
            self.start_after_event(add_seconds(t_us, self.entry.at_s))
            return True
        # One that acts, or waits for its end, is not started a second time.
        if (
            self.active
            or self.condition is None
            or self._waits_for_event
            or t_us < self.earliest_us
        ):
            return False
        if self.start_us < NEVER_US or not self._may_start_again():
            return False
        # False again: the next time it holds counts as a new start.
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
        """Become active; every direction starts with a fresh state."""
        self.active = True
        self.starts += 1
        self.states = {}

    def end_activation(self, now_us: int) -> None:
        """End a stretch; set the next start if the entry repeats, leaving out what is long past."""
        self.active = False
        repeat = self.entry.repeat
        if repeat is not None and repeat.every_s is not None:
            # A clock that leapt ahead passes whole repetitions: they count, but nothing acts in
            # them.
            missed = int((now_us - self.start_us) * 1e-6 / repeat.every_s) - 1
            self.starts += max(missed, 0)
            if repeat.times is None or self.starts < repeat.times:
                next_us = add_seconds(self.start_us, repeat.every_s * (1 + max(missed, 0)))
                self.start_us = max(next_us, self.start_us + 1)  # it cannot stand still
                self.end_us = self._end()
                return
        self.start_us = self.end_us = NEVER_US

    @property
    def next_us(self) -> int:
        """When it starts or ends by the clock."""
        return self.end_us if self.active else self.start_us

    @property
    def done(self) -> bool:
        """Whether it has acted and will not start again by the clock."""
        return not self.active and self.start_us == NEVER_US and self.starts > 0

    def matches(self, frame: Frame, direction: str) -> bool:
        """Whether `where` lets the frame through to the fault."""
        if self.matches_all:
            return True
        system, component, way, instance = self._where
        if system is not None and frame.system != system:
            return False
        if component is not None and frame.component != component:
            return False
        if way is not None and direction != way:
            return False
        return instance is None or self._instance(frame) == instance

    @staticmethod
    def _instance(frame: Frame) -> object:
        # Where a message has no instance of its own, most carry an `id`.
        name = frame.layout.instance or "id"
        return frame.read(name) if name in frame.layout.fields else 0

    def matches_junk(self, direction: str) -> bool:
        """Whether bytes that are no frame pass through the fault."""
        system, component, way, instance = self._where
        # Junk has no sender that a filter could ask for.
        if not self.takes_bytes or (system, component, instance) != (None, None, None):
            return False
        return way is None or way == direction

    def act(self, frame: Frame | bytes, direction: str, t_us: int) -> list[Outgoing]:
        """Put a frame through the fault and count what it did."""
        if self.skips_by_chance():
            return [Outgoing(t_us, frame)]
        try:
            sends = self._apply(frame, direction, t_us)
        except Exception as error:  # others write faults too: theirs must not end the forwarding
            self.note_failure(error)
            return [Outgoing(t_us, frame)]
        # Untouched and on time: nothing was done.
        if len(sends) == 1 and sends[0].frame is frame and sends[0].due_us == t_us:
            return sends
        # What was kept back and leaves as it came was not touched; what changed has a magnitude.
        touched = sum(out.magnitude is not None for out in sends) if self.keeps_back else 1
        if touched:
            self.note_changed_frame(direction, t_us)
            sizes = [out.magnitude for out in sends if out.magnitude is not None]
            # NaN and infinity would stick in the maximum for ever.
            largest = max((size for size in sizes if math.isfinite(size)), default=-1.0)
            self.count_frames(touched, sum(out.saturated for out in sends), largest)
        return sends

    def skips_by_chance(self) -> bool:
        """Whether chance lets this frame pass by the fault."""
        # No draw without a probability: the stream stays that of the fault.
        chance = self.entry.probability
        return chance < 1.0 and bool(self.rng.random() >= chance)

    def note_failure(self, error: Exception) -> None:
        """Count a frame that passes because the fault failed; the first time it is logged."""
        if not self.failures:
            LOG.exception("fault %s failed; the frame passes as it came", self.entry.id)
        self.failures += 1
        self.failure = repr(error)

    def note_changed_frame(self, direction: str, t_us: int) -> None:
        """Note that a frame of this direction was touched."""
        if self.first_us is None:
            self.first_us = t_us
            self.direction = direction
            self.needs_attention = True
        elif self.direction != direction:
            self.direction = BOTH_DIRECTIONS

    def _apply(self, frame: Frame | bytes, direction: str, t_us: int) -> list[Outgoing]:
        """What the fault makes of a frame, its state of that direction brought up to date."""
        state = self.states.get(direction)
        if state is None and direction not in self.states:
            state = self.fresh_state(direction)
        sends: list[Outgoing]
        sends, state = self.fault.apply(frame, t_us, state, self.rng)
        self.states[direction] = state
        if self.ends_itself and self.fault.done(state):
            self.end_early(t_us)
        return sends

    def end_early(self, t_us: int) -> None:
        """End with the next frame, before its time."""
        self.end_us, self.needs_attention = t_us, True

    def fresh_state(self, direction: str) -> Any:
        """The state with which a direction starts, also where the value was given live."""
        state = self.fault.new_state(self.start_us)
        if self.live is not None:
            state = self.fault.fed(state, *self.live)
        self.states[direction] = state
        return state

    def count_frames(self, frames: int, saturated: int, magnitude: float) -> None:
        """Count what was done in this fault's name; a negative magnitude is none."""
        self.frames += frames
        self.saturated += saturated
        if magnitude > self._largest:
            self._largest = magnitude

    def release_us(self) -> int:
        """When the fault must let go of the oldest frame it keeps."""
        if not self.buffers:
            return NEVER_US
        times = [self.fault.release_us(state) for state in self.states.values()]
        return min((time for time in times if time is not None), default=NEVER_US)

    def release(self, t_us: int, *, overdue: bool) -> list[Outgoing]:
        """What the fault keeps: all of it, or only where the oldest is overdue."""
        sends: list[Outgoing] = []
        for direction, state in self.states.items() if self.buffers else ():
            until_us = self.fault.release_us(state)
            if not overdue or (until_us is not None and until_us <= t_us):
                released, self.states[direction] = self.fault.release(t_us, state)
                sends += released
        return sends

    def label(self, end_us: int | None) -> Label:
        """The label of the present stretch, open or complete."""
        entry = self.entry
        where = {
            key: value
            for key in ("system", "component", "id", "direction")
            if (value := getattr(entry.where, key)) is not None
        }
        return Label(
            id=entry.id,
            fault=entry.name,
            preset=entry.preset,
            targets=entry.targets,
            direction=self.direction,
            t0_us=self.t0_us,
            start_us=self.first_us or 0,
            end_us=end_us,
            frames=self.frames,
            magnitude=self.magnitude,
            saturated=self.saturated,
            where=where,
            parameters=entry.parameters,
            seed=self.seed,
            value=self.value,
            changed_us=self.changed_us,
        )

    def pending_label(self, t_us: int) -> Label | None:
        """The label of a stretch that has just touched its first frame, or of a new value."""
        if self.first_us is None:
            return None
        if self._announced_us is None:
            self.changed_us = None  # what was given before is the value that it began with
        # A slider moves many times a second: labels tell of it a few times.
        elif not self.unannounced or t_us - self._announced_us < VALUE_LABEL_INTERVAL_US:
            return None
        self.unannounced = self.needs_attention = False
        self._announced_us = t_us
        return self.label(None)

    def close(self, t_us: int) -> Label | None:
        """The complete label of a stretch that ended, and a clean count; None if it did nothing."""
        # A stretch in which nothing was touched has no label. What ends one may bear an older
        # stamp than its first frame: an answer without a stamp of its own, say.
        label = None if self.first_us is None else self.label(max(t_us, self.first_us))
        self._earlier_frames += self.frames
        self.frames = self.saturated = 0
        self._largest = -1.0
        self.first_us = self.changed_us = self._announced_us = None
        self.direction = ""
        return label

    def set_value(self, value: float, t_us: int, latency_us: int | None) -> None:
        """Take a live value, or another constant one.

        Raises
        ------
        ConfigError
            If the fault has no value.
        """
        inner = getattr(self.fault, "fault", self.fault)  # what acts on satellites is wrapped
        profile = getattr(inner, "profile", None)
        if profile is not None and profile.live is not None:
            self._stream(value, t_us, latency_us, profile.live.timeout_s)
        else:
            self._change(inner, value)
        # The same value again is no news.
        if value != self.value:
            self.value, self.changed_us, self.unannounced = value, t_us, True
            self.needs_attention = True

    def _change(self, inner: Any, value: float) -> None:
        """Take another constant value."""
        if getattr(inner, "value", None) is None:
            raise ConfigError(
                f"update: {self.entry.id} ({self.entry.name}) has no value to change; "
                "clear it and arm another"
            )
        try:
            hints = get_type_hints(type(inner), include_extras=True)
            changed = msgspec.structs.replace(inner, value=msgspec.convert(value, hints["value"]))
        except (ValueError, msgspec.ValidationError) as error:
            # The value's own limits hold for live changes too.
            raise ConfigError(f"update: {self.entry.id} = {value}: {error}") from None
        wrapped = inner is not self.fault
        self.fault = msgspec.structs.replace(self.fault, fault=changed) if wrapped else changed
        written = {**self.entry.written, "value": value}
        self.entry = msgspec.structs.replace(self.entry, fault=self.fault, written=written)

    def _stream(self, value: float, t_us: int, latency_us: int | None, timeout_s: float) -> None:
        if latency_us is not None:
            self.latency_us = latency_us
            # A stale command must not move a vehicle.
            if latency_us > timeout_s * 1e6:
                raise ConfigError(
                    f"update: {self.entry.id} = {value} is {latency_us / 1e6:.3f} s old; "
                    f"values older than {timeout_s} s are refused"
                )
        self.live = (value, t_us)
        for direction, state in self.states.items():
            self.states[direction] = self.fault.fed(state, value, t_us)

    def state(self) -> dict[str, Any]:
        """What a page shows of it; the same object as before where nothing has changed."""
        now = (
            self.active, self.starts, self.start_us, self.end_us, self.total_frames, self.magnitude,
            self.saturated, self.sealed, self.failures, self.latency_us, self.value,
        )  # fmt: skip
        # Of a thousand entries nearly all wait: to describe them anew would hold frames up.
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
            "saturated": self.saturated,
            "signed_skipped": self.sealed,
            "failures": self.failures,
            "failure": self.failure,
            "latency_us": self.latency_us,
            "value": self.value,
            "parameters": self.entry.parameters,
        }
