"""Active entries written down as rows of numbers.

A message goes the compiled way if all entries that act on it have a rule. What a rule remembers
lies in `memory`, and both ways draw from the same generators, machine code by the address of
numpy's functions. numpy is loaded only for that: it would hold up the first frame of a fault.
"""

import ctypes
import itertools
from array import array
from collections.abc import Sequence
from typing import Any

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.fault_parts.elements import Element, locate_element
from mavproxy_fault.fault_parts.memory import Memory
from mavproxy_fault.fault_parts.rules import (
    LINK_RULES,
    VALUE_RULES,
    Numbers,
    RuleFault,
    RuleLinkFault,
)
from mavproxy_fault.faults.bit_faults import BitFlip
from mavproxy_fault.faults.plant_fault import SimulatorFault
from mavproxy_fault.faults.registry import numbered_rules, our_faults
from mavproxy_fault.faults.timestamp_faults import TimestampFault, stamp_fields
from mavproxy_fault.proxy.active_entry import WAYS, ActiveEntry
from mavproxy_fault.proxy.interfaces import NEVER_US
from mavproxy_fault.wire.dialect import Layout

EFFECTS = {
    "delay": k.DELAY, "copies": k.COPIES, "renumber": k.RENUMBER, "cut": k.CUT, "mix": k.MIX,
}  # fmt: skip
LARGEST_SHIFT_S = 1e9  # of a timestamp: with it microseconds are exact as numbers


def memories_of(running: ActiveEntry) -> list[tuple[int, tuple[int, ...], Memory]]:
    """What an entry with a rule remembers: direction, sender (or nothing), and where."""
    found: list[tuple[int, tuple[int, ...], Memory]] = []
    for way, state in running.states.items():
        if isinstance(state, Memory):
            found.append((WAYS.index(way), (), state))
        elif isinstance(getattr(state, "inner", None), dict):
            found += [(WAYS.index(way), key, memory) for key, memory in state.inner.items()]
    return found


def stage(running: ActiveEntry) -> tuple[Any, int, int]:
    """Return an entry's fault, when its next label is due, and how much it remembers."""
    return running.fault, running.label_us, len(memories_of(running))


def draw_addresses(kind: str, rng: Any) -> tuple[int, int]:
    """Return the addresses of numpy's function that draws a number of a kind, and of its argument.

    That is the generator's state, which calls from Python advance too.
    """
    from numpy.random import _generator

    name = "random_standard_uniform" if kind == "random" else f"random_{kind}"
    function = ctypes.cast(ctypes.CDLL(_generator.__file__)[name], ctypes.c_void_p).value or 0
    return function, rng.bit_generator.ctypes.bit_generator.value


def write_row(table: Any, row: int, values: Sequence[float]) -> None:
    """Write numbers to the columns of a row."""
    for column, value in enumerate(values):
        table[row, column] = value


class Plans:
    """The rows of all planned entries."""

    def __init__(self, shared: k.Shared) -> None:
        self._shared = shared
        self.key_count = 0
        self._running: list[ActiveEntry] = []  # by row
        self._rows: dict[ActiveEntry, int | None] = {}
        self._stages: list[tuple[ActiveEntry, tuple[Any, int, int]]] = []
        self._steps_used = self._elements_used = self._numbers_used = 0

    def clear(self) -> None:
        """Forget all rows."""
        self._running, self._rows, self._stages = [], {}, []
        self._steps_used = self._elements_used = self._numbers_used = self.key_count = 0

    @property
    def changed(self) -> bool:
        """Whether an entry has got other parameters, or has come further."""
        return any(stage(running) != before for running, before in self._stages)

    def follow_idle(self) -> None:
        """Note when the core has to see the next frame of faults that act at intervals."""
        for row, running in enumerate(self._running):
            idle_until_us = getattr(running.fault, "idle_until_us", None)
            if idle_until_us is not None:
                states = running.states.values()
                self._shared.entries[row, k.UNTIL] = min(map(idle_until_us, states), default=0)

    def add(self, layout: Layout, acting: Sequence[ActiveEntry]) -> int | None:
        """Write the chain of entries that act on a message; the first row, None if one cannot."""
        used = self._steps_used
        copying = [one.fault for one in acting if getattr(one.fault, "effect", "") == "copies"]
        if len(acting) > k.MOST_CHAIN or len(copying) > 1:
            return None
        if any(fault.copies >= k.MOST_WORK for fault in copying):
            return None
        for running in acting:
            row = self._row(running)
            if row is None or not self._add_step(layout, running, row):
                return None
        for step, following in itertools.pairwise([*range(used, self._steps_used), -1]):
            self._shared.steps[step, k.NEXT] = following
        return used

    # Rows of entries

    def _row(self, running: ActiveEntry) -> int | None:
        """Return the row of an entry, None if it has no rule or there is no room."""
        if running not in self._rows:
            self._stages.append((running, stage(running)))
            self._rows[running] = self._new_row(running)
        return self._rows[running]

    def _new_row(self, running: ActiveEntry) -> int | None:
        fault, row = running.fault, len(self._running)
        kind = type(fault)
        if running.entry.where.endpoint is not None:
            return None
        if row == k.MOST_ENTRIES or our_faults().get(getattr(kind, "name", "")) is not kind:
            return None
        plan = [-1] * k.ENTRY_SIZE
        if isinstance(fault, RuleFault) and fault.rule is not None:
            plan[k.EFFECT], plan[k.RULE] = k.VALUES, numbered_rules(VALUE_RULES).index(fault.rule)
            profile = getattr(fault, "profile", None)
            # One more than the numbers of an element; 0 for no memory.
            shared = profile is not None and profile.remembers
            plan[k.REMEMBERS] = fault.remembers + 1 if fault.remembers or shared else 0
        elif isinstance(fault, RuleLinkFault) and getattr(fault, "profile", None) is None:
            plan[k.EFFECT] = EFFECTS[fault.effect]
            plan[k.RULE] = numbered_rules(LINK_RULES).index(fault.rule)
            plan[k.REMEMBERS] = int(fault.remembers > 0)
        elif isinstance(fault, TimestampFault) and max(map(abs, fault.error())) < LARGEST_SHIFT_S:
            plan[k.EFFECT], plan[k.RULE] = k.VALUES, numbered_rules(VALUE_RULES).index(fault.rule)
            plan[k.REMEMBERS] = 0
        elif isinstance(fault, BitFlip):
            plan[k.EFFECT], plan[k.REMEMBERS] = k.FLIP, 0
        elif isinstance(fault, SimulatorFault):
            plan[k.EFFECT], plan[k.REMEMBERS] = k.IDLE, 0
        else:
            return None
        begun = running.label_us > -NEVER_US
        plan[k.START], plan[k.BY_SENDER] = running.start_us, getattr(fault, "by_sender", False)
        plan[k.SEALED_TOO], plan[k.ANNOUNCED] = running.takes_sealed, begun
        plan[k.COUNTS_AT], plan[k.TAKES_BYTES] = running.counts.at, running.takes_bytes
        # The core sees the first frame of a fault that has something to do at intervals.
        plan[k.UNTIL] = 0 if hasattr(fault, "idle_until_us") else NEVER_US
        plan[k.ON_LINK] = running.on_link
        plan[k.LABEL_AT] = running.label_us if begun else NEVER_US
        plan[k.SYSTEM : k.INSTANCE + 1] = running.where
        plan[k.DRAW_COUNT] = getattr(fault, "draw_count", 1)
        if drawn := getattr(fault, "drawn", ""):
            plan[k.DRAW : k.DRAWS_FROM + 1] = draw_addresses(drawn, running.rng)
        if running.entry.probability < 1.0:
            plan[k.CHANCE : k.CHANCES_FROM + 1] = draw_addresses("random", running.chance_rng)
        if not self._add_keys(running, row):
            return None
        write_row(self._shared.entries, row, plan)
        self._shared.chances[row] = running.entry.probability
        self._running.append(running)
        return row

    def _add_keys(self, running: ActiveEntry, row: int) -> bool:
        for way, key, memory in memories_of(running):
            if self.key_count == k.MOST_KEYS:
                return False
            system, component, message, instance = key or (0, 0, 0, 0)
            values = (row, way, system << 8 | component, message, instance, memory.at)
            write_row(self._shared.keys, self.key_count, values)
            self.key_count += 1
        return True

    # Chains

    def _elements_of(
        self, layout: Layout, fault: Any
    ) -> list[tuple[Element, Numbers, float, float]]:
        """The elements of a message that a fault acts on: numbers, unit, and step of the label."""
        if isinstance(fault, TimestampFault):
            return [
                (locate_element(layout, name), (*fault.error(), scale), 1.0, scale)
                for name, scale in stamp_fields(layout).items()
            ]
        if not isinstance(fault, RuleFault | BitFlip):
            return []
        elements = fault.elements[layout.id]
        factors = fault.factors.get(layout.id, (1.0,) * len(elements))
        rows = fault.numbers(len(elements))
        return [(*one, 1.0) for one in zip(elements, rows, factors, strict=True)]

    def _add_step(self, layout: Layout, running: ActiveEntry, row: int) -> bool:
        """Write the row of one entry on one message, where it can act there."""
        found, fault = self._elements_of(layout, running.fault), running.fault
        inexact = self._shared.entries[row, k.REMEMBERS] > 0 or isinstance(fault, BitFlip)
        numbers = fault.numbers() if isinstance(fault, RuleLinkFault) else ()
        room = sum(len(one[1]) for one in found) + len(numbers)
        if (
            any(one.code in "qQ" and inexact for one, *_ in found)
            or self._steps_used == k.MOST_STEPS
            or self._elements_used + len(found) > k.MOST_ELEMENTS
            or self._numbers_used + room > k.MOST_NUMBERS
            or len(found) > k.SLOT // 2
        ):
            return False
        first = self._elements_used
        step = (
            row, first, first + len(found), -1, max((one.end for one, *_ in found), default=0),
            self._numbers_used,
        )  # fmt: skip
        write_row(self._shared.steps, self._steps_used, step)
        self._steps_used += 1
        self._add_numbers(numbers)
        for one, values, factor, scale in found:
            place = self._elements_used
            kind = k.REAL if one.code in "fd" else k.SIGNED if one.code.islower() else k.UNSIGNED
            element = (one.start, one.end - one.start, kind, self._numbers_used)
            write_row(self._shared.elements, place, element)
            write_row(self._shared.factors, place, (factor, scale))
            self._add_numbers(values)
            self._elements_used += 1
        return True

    def _add_numbers(self, numbers: Numbers) -> None:
        end = self._numbers_used + len(numbers)
        self._shared.numbers[self._numbers_used : end] = array("d", numbers)
        self._numbers_used = end
