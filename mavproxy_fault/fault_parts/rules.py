"""Rules: what a built-in fault does, written once as arithmetic on flat arrays of numbers.

Python calls a rule for single frames, `mavproxy_fault.compiled` compiles the same function for
dense traffic. So a rule uses only its arguments, numbers and `math`:

    value rule  rule(x, i, t_s, p, at, m, place, u) -> the faulty value of element i
    link rule   rule(t_us, p, at, m, place, u, v) -> what becomes of the frame

`x` are the healthy values of all elements, `p[at]` and following the parameters, `m[place]` and
following what it remembers (zeros at first), `u` and `v` random numbers of the kind that the fault
draws.
"""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Literal

from mavproxy_fault.fault_parts.fault import Generator, LinkFault, Outgoing
from mavproxy_fault.fault_parts.memory import ARENA, NO_MEMORY, Memory
from mavproxy_fault.fault_parts.value_fault import ValueFault
from mavproxy_fault.wire.frame import STX_V2, Frame, Number

Numbers = Sequence[float]
Rule = Callable[..., Any]
Drawn = Literal["", "random", "standard_normal", "standard_exponential"]
Effect = Literal["delay", "copies", "cut", "renumber"]
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
            rule(before, i, t_s, rows[i], 0, ARENA, memory.at + i * step, draws[i])
            for i in range(count)
        ], state


class RuleLinkFault(LinkFault, frozen=True, kw_only=True):
    """A fault of the link with a rule, which acts on each frame by one number.

    By `effect` that number is a delay in microseconds or `LOST`, a count of copies, of bytes that
    are cut off, or an offset of the sequence number. The rule's parameters are the fields named in
    `parameters`. `remembers` is the count of numbers that it keeps per direction, `drawn` and
    `draw_count` are kind and count of the random numbers for a frame.
    """

    rule: ClassVar[Rule]
    parameters: ClassVar[tuple[str, ...]] = ("value",)
    effect: ClassVar[Effect] = "delay"
    remembers: ClassVar[int] = 0
    drawn: ClassVar[Drawn] = ""
    draw_count: ClassVar[int] = 1

    def numbers(self) -> Numbers:
        """Return the parameters of the rule."""
        return [float(getattr(self, name)) for name in self.parameters]

    def new_state(self, start_us: int) -> Memory:
        """Return the memory of one direction, which begins with the start time."""
        if not self.remembers:
            return NO_MEMORY
        memory = Memory(self.remembers)
        memory.write([float(start_us)])
        return memory

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Memory, rng: Generator
    ) -> tuple[list[Outgoing], Memory]:
        """Apply the rule to the frame."""
        u, *more = getattr(rng, self.drawn)(self.draw_count).tolist() if self.drawn else (0.0,)
        v = more[0] if more else 0.0
        number = int(type(self).rule(float(t_us), self.numbers(), 0, ARENA, state.at, u, v))
        if self.effect == "delay":
            return ([] if number == LOST else [delayed(frame, t_us, number)]), state
        if self.effect == "copies":
            span_us = int(self.numbers()[2])  # spread evenly
            copies = [delayed(frame, t_us, span_us * (n + 1) // number) for n in range(number)]
            return [Outgoing(t_us, frame), *copies], state
        if not number:
            return [Outgoing(t_us, frame)], state
        raw = frame if isinstance(frame, bytes) else frame.raw
        if self.effect == "cut":
            return [Outgoing(t_us, raw[: max(len(raw) - number, 1)])], state
        assert isinstance(frame, Frame)
        return [Outgoing(t_us, renumbered(frame, number))], state


def delayed(frame: Frame | bytes, t_us: int, by_us: int) -> Outgoing:
    """Return a frame delayed by a time; its magnitude is the delay, none without one."""
    return Outgoing(t_us + by_us, frame, by_us * 1e-6 if by_us else None)


def renumbered(frame: Frame, ahead: int) -> Frame:
    """Return a frame with its sequence number advanced, and a new checksum."""
    raw = bytearray(frame.raw)
    at = 4 if raw[0] == STX_V2 else 2
    raw[at] = (raw[at] + ahead) & 0xFF
    return Frame(bytes(raw), frame.layout).with_payload(frame.payload)
