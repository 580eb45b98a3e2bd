"""Rules: what a built-in fault does, written once as arithmetic on flat arrays of numbers.

Python calls a rule for single frames, `mavproxy_fault.compiled` compiles the same function for
dense traffic. So a rule uses only its arguments, numbers and `math`:

    value rule  rule(x, i, t_s, p, m, u) -> the faulty value of element i
    link rule   rule(t_us, size, p, m, u, v) -> what becomes of the frame

`x` are the healthy values of all elements, `p` its parameters, `m` what it remembers
(zeros at first), `size` the bytes of the frame, `u` and `v` random
numbers of the kind that the fault draws.
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal

import msgspec

from mavproxy_fault.fault_parts.fault import Generator, LinkFault, Outgoing
from mavproxy_fault.fault_parts.memory import NO_MEMORY, Memory
from mavproxy_fault.fault_parts.profile import Profile, hold_live_value
from mavproxy_fault.fault_parts.value_fault import ValueFault
from mavproxy_fault.wire.frame import STX_V2, Frame, Number

Numbers = Sequence[float]
Rule = Callable[..., Any]
Drawn = Literal["", "random", "standard_normal", "standard_exponential"]
Effect = Literal["delay", "copies", "cut", "renumber", "mix"]
LOST = -1  # what a rule with the effect `delay` returns for a lost frame

VALUE_RULES: list[Rule] = []
LINK_RULES: list[Rule] = []


def value_rule(function: Rule) -> Rule:
    """Register a rule of values."""
    VALUE_RULES.append(function)
    return function


def link_rule(function: Rule) -> Rule:
    """Register a rule of links."""
    LINK_RULES.append(function)
    return function


class RuleFault(ValueFault, frozen=True, kw_only=True):
    """A value fault with a rule.

    The rule's parameters are the fields named in `parameters`. `remembers` is the count of numbers
    that it keeps per element, `drawn` the kind of random number that it needs for each.
    """

    rule: ClassVar[Any]
    parameters: ClassVar[tuple[str, ...]] = ("value",)
    remembers: ClassVar[int] = 0
    drawn: ClassVar[Drawn] = ""

    def numbers(self, count: int) -> list[Numbers]:
        """Return the parameters of each of `count` elements."""
        return [[float(getattr(self, name)) for name in self.parameters]] * count

    def new_memory(self, count: int, rng: Any) -> Memory:
        """Return the memory of one sender."""
        return Memory(count * self.remembers) if self.remembers else NO_MEMORY

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[Sequence[Number], Any]:
        """Apply the rule to each element; the state is the memory by sender."""
        count, rule, step = len(before), self.rule, self.remembers
        if state is None:
            state = {}
        key = key if self.by_sender else ()
        memory = state.get(key)
        if memory is None:
            memory = state[key] = self.new_memory(count, rng)
        draws = getattr(rng, self.drawn)(count).tolist() if self.drawn else (0.0,) * count
        rows = self.numbers(count)
        return [
            rule(before, i, t_s, rows[i], memory.numbers[i * step :], draws[i])
            for i in range(count)
        ], state


class RuleLinkFault(LinkFault, frozen=True, kw_only=True):
    """A fault of the link with a rule, which acts on each frame by one number.

    By `effect` that number is a delay in microseconds or `LOST`, a count of copies, of bytes that
    are cut off or changed, or an offset of the sequence number. The rule's parameters are the
    fields named in `parameters`. `remembers` is the count of numbers that it keeps per direction.
    It draws random numbers unless it is `certain`.
    """

    rule: ClassVar[Rule]
    parameters: ClassVar[tuple[str, ...]] = ("value",)
    effect: ClassVar[Effect] = "delay"
    remembers: ClassVar[int] = 0
    certain: ClassVar[bool] = False

    @property
    def draw_count(self) -> int:
        """One, and one more to choose whether it is that of the frame before."""
        return 2 if getattr(self, "correlation", 0.0) else 1

    @property
    def drawn(self) -> Drawn:
        """The kind of random number that the rule needs; none for all frames (a share of 1)."""
        value = getattr(self, "value", None)
        return "" if self.certain or (value is not None and value >= 1.0) else "random"

    def numbers(self) -> Numbers:
        """Return the parameters of the rule."""
        return [float(getattr(self, name) or 0.0) for name in self.parameters]

    def new_state(self, start_us: int) -> Memory:
        """Return the memory of one direction, which begins with the start time."""
        if not self.remembers:
            return NO_MEMORY
        memory = Memory(self.remembers)
        memory.write([float(start_us)])
        return memory

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: Generator
    ) -> tuple[list[Outgoing], Any]:
        """Apply the rule to the frame."""
        return self.outcome(frame, t_us, state, rng), state

    def outcome(
        self, frame: Frame | bytes, t_us: int, memory: Memory, rng: Generator
    ) -> list[Outgoing]:
        """Return what the rule makes of the frame."""
        raw = frame if isinstance(frame, bytes) else frame.raw
        number, p = self.choose(len(raw), t_us, memory, rng), self.numbers()
        if self.effect == "delay":
            return [] if number == LOST else [delayed(frame, t_us, number)]
        if self.effect == "copies":
            span_us = int(p[3])  # spread evenly
            copies = [delayed(frame, t_us, span_us * (n + 1) // number) for n in range(number)]
            return [Outgoing(t_us, frame), *copies]
        if not number:
            return [Outgoing(t_us, frame)]
        if self.effect == "cut":
            return [Outgoing(t_us, raw[: max(len(raw) - number, 1)])]
        assert isinstance(frame, Frame)
        return [Outgoing(t_us, renumbered(frame, number))]

    def choose(self, size: int, t_us: int, memory: Memory, rng: Generator) -> int:
        """Return the rule's number for a frame of `size` bytes."""
        u, *more = getattr(rng, self.drawn)(self.draw_count).tolist() if self.drawn else (0.0,)
        v, p = more[0] if more else 0.0, self.numbers()
        return int(type(self).rule(float(t_us), size, p, memory.numbers, u, v))


class ProfiledState(msgspec.Struct):
    """The state of a fault whose value follows a profile; it is created at the first frame."""

    memory: Memory
    start_us: int
    profile: Any = None


class ProfiledLinkFault(RuleLinkFault, frozen=True, kw_only=True):
    """A fault of the link with a `value`, or a profile of it; only the former is compiled.

    Where the profile has no value the frame passes.
    """

    default: ClassVar[float | None] = None

    value: float | None = None
    profile: Profile | None = None

    def __post_init__(self) -> None:
        if self.value is None and self.profile is None and self.default is not None:
            msgspec.structs.force_setattr(self, "value", self.default)
        if (self.value is None) == (self.profile is None):
            raise ValueError("needs exactly one of value and profile")

    def new_state(self, start_us: int) -> Any:
        """Return the memory, with a profile also its state."""
        memory = super().new_state(start_us)
        return memory if self.profile is None else ProfiledState(memory, start_us)

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: Generator
    ) -> tuple[list[Outgoing], Any]:
        """Apply the rule with the present value."""
        if self.profile is None:
            return super().apply(frame, t_us, state, rng)
        state.profile = state.profile or self.profile.new_state(rng)
        value = self.profile.value((t_us - state.start_us) / 1e6, state.profile)
        if value is None:
            return [Outgoing(t_us, frame)], state
        now = msgspec.structs.replace(self, value=max(value, 0.0), profile=None)
        return now.outcome(frame, t_us, state.memory, rng), state

    def fed(self, state: Any, value: float, t_us: int) -> Any:
        """Return the state after a live value that arrived at `t_us`."""
        state.profile = hold_live_value(state.profile, state.start_us, t_us, value)
        return state


def repeated_draw(u: float, v: float, share: float, m: Any) -> float:
    """Return the draw of the frame before with a probability, else the new one.

    So both the distribution of the draws and their correlation, `share`, are as given. The new one
    lies at `m[1]` from the first frame on, when `m[0]` is set.
    """
    if not m[0] or v >= share:
        m[0], m[1] = 1.0, u
    return float(m[1])


def choose_place(n: int, count: int, size: int, draws: Any) -> int:
    """Return the n-th of `count` different places out of `size`, drawn with `draws[n]`.

    That becomes the place, as those before it are (Bentley and Floyd, CACM 30(9), 1987).
    """
    last = size - count + n
    place = int(draws[n] * (last + 1))
    for earlier in range(n):
        if draws[earlier] == place:
            place = last
    draws[n] = float(place)
    return place


def delayed(frame: Frame | bytes, t_us: int, by_us: int) -> Outgoing:
    """Return a frame delayed by a time; its magnitude is the delay, none without one."""
    return Outgoing(t_us + by_us, frame, by_us * 1e-6 if by_us else None)


def renumbered(frame: Frame, ahead: int) -> Frame:
    """Return a frame with its sequence number advanced, and a new checksum."""
    raw = bytearray(frame.raw)
    at = 4 if raw[0] == STX_V2 else 2
    raw[at] = (raw[at] + ahead) & 0xFF
    return Frame(bytes(raw), frame.layout).with_payload(frame.payload)
