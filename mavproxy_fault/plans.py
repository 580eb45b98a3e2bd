"""Faults written down for the compiled path: bias, scale, constant, drift, noise and freeze.

A fault's first frame, and with it the label and the drawn segments, are the plain path's; then its
rows say what to do with the next ones. Noise is drawn ahead in blocks; before the plain path may
draw again, its generator is set back to where the compiled path stopped, so that both give the same
bytes.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mavproxy_fault import tables as k
from mavproxy_fault.faults.driven import Bias, Constant, Drift, Driven, Scale
from mavproxy_fault.faults.freeze import Freeze
from mavproxy_fault.faults.noise import Noise
from mavproxy_fault.faults.place import Element
from mavproxy_fault.faults.value import each
from mavproxy_fault.running import Running
from mavproxy_fault.wire.dialect import Field, Layout

MODES = {"add": k.ADD, "scale": k.SCALE, "replace": k.REPLACE}
WAYS = {"to-vehicle": 0, "from-vehicle": 1}
CODES = "bBhHiIfd"  # 64-bit integers do not fit the kernel's arithmetic
KINDS = (Bias, Scale, Constant, Drift, Noise, Freeze)
Values = Sequence[float]


class Planned(NamedTuple):
    """A fault that the compiled path carries out: its first row, and the block it draws from."""

    first: int
    running: Running
    fault: Any
    block: int | None


class Plans:
    """The rows of all planned faults, and the random numbers drawn ahead for them."""

    def __init__(self) -> None:
        self.rows = np.zeros((k.MOST_PLANS, k.PLAN_SIZE), np.int64)
        self.numbers = np.zeros((k.MOST_PLANS, 2))
        self.hits = np.zeros((k.MOST_PLANS, 4), np.int64)
        self.steps = np.full(k.MOST_PLANS, -1.0)
        self.pieces = np.zeros((k.MOST_PIECES, 4))
        self.draws = np.zeros(k.MOST_DRAWN * k.BLOCK)
        self._planned: list[Planned] = []
        self._states: list[Any] = []  # of the generators, where their blocks begin
        self._rows_used = self._pieces_used = 0

    def clear(self) -> None:
        """Forget all rows."""
        self._planned = []
        self._rows_used = self._pieces_used = 0

    @property
    def changed(self) -> bool:
        """Whether a fault has got other parameters, or one that waited has met its first frame."""
        return any(
            one.running.fault is not one.fault
            or (one.first < 0 and one.running.first_us is not None)
            for one in self._planned
        )

    def add(self, layout: Layout, acting: Sequence[Running]) -> int | None:
        """Rows for all faults that act on a message, in turn; the first one's, None if plain."""
        before = len(self._planned), self._rows_used, self._pieces_used
        previous = first = -1
        for running in acting:
            row = self._one(layout, running)
            if row is None:
                waiting = [one for one in self._planned[before[0] :] if one.first < 0]
                self._planned[before[0] :] = waiting
                _, self._rows_used, self._pieces_used = before
                return None
            first = row if first < 0 else first
            if previous >= 0:
                self.rows[previous, k.NEXT] = row
            previous = row
        return first

    def _one(self, layout: Layout, running: Running) -> int | None:
        """Write a fault's rows; the first, or None where it must stay with the plain path."""
        fault, where = running.fault, running.entry.where
        if type(fault) not in KINDS or running.entry.probability < 1 or where.id is not None:
            return None
        if running.first_us is None:
            self._planned.append(Planned(-1, running, fault, None))
            return None
        places = fault.elements.get(layout.id, ())
        fields = [layout.fields[name] for name, _ in places]
        first = self._rows_used
        if first + len(places) > k.MOST_PLANS or any(f.code not in CODES for f in fields):
            return None
        plan = self.rows[first]
        plan[:] = -1
        plan[k.ROWS], plan[k.START] = len(places), running.start_us
        plan[k.SYSTEM : k.DIRECTION + 1] = [
            -1 if one is None else one
            for one in (where.system, where.component, WAYS.get(where.direction or ""))
        ]
        block = self._source(layout, running, plan, places)
        if plan[k.SOURCE] < 0:
            return None
        self._elements(first, fields, places)
        self.hits[first], self.steps[first] = 0, -1.0
        self._planned.append(Planned(first, running, fault, block))
        self._rows_used += len(places)
        return first

    def _elements(self, first: int, fields: list[Field], places: tuple[Element, ...]) -> None:
        for n, (field, (_, index)) in enumerate(zip(fields, places, strict=True)):
            self.rows[first + n, k.OFFSET] = field.offset + index * field.size
            self.rows[first + n, k.CODE] = ord(field.code)

    # What meets the healthy value

    def _source(
        self, layout: Layout, running: Running, plan: Any, places: tuple[Element, ...]
    ) -> int | None:
        """Fill in mode, source and numbers; the source stays -1 if the fault cannot be planned."""
        fault, first, count = running.fault, self._rows_used, len(places)
        numbers = self.numbers[first : first + count]
        plan[k.MODE] = k.ADD
        if isinstance(fault, Freeze):
            self._held(layout, running, plan, numbers)
        elif isinstance(fault, Noise):
            return self._noise(fault, plan, numbers)
        elif isinstance(fault, Drift):
            plan[k.SOURCE] = k.GROWS
            numbers[:, k.VALUE] = each(fault.value, count)
            numbers[:, k.LIMIT] = math.inf if fault.limit is None else fault.limit
        elif fault.profile is None:
            plan[k.MODE], plan[k.SOURCE] = MODES[fault.mode], k.NUMBER
            numbers[:, k.VALUE] = each(fault.value, count)
        elif fault.profile.segments is not None:
            self._segments(fault, running, plan, numbers)
        return None

    def _known(self, running: Running, plan: Any) -> Any:
        """The fault's state if it has only one; frames of the other direction stay plain."""
        if len(running.states) != 1:
            return None
        [(way, state)] = running.states.items()
        plan[k.KNOWN_WAY] = WAYS[way]
        return state.memory

    def _segments(self, fault: Driven, running: Running, plan: Any, numbers: Any) -> None:
        pieces = self._known(running, plan)
        end = self._pieces_used + len(pieces or ())
        if not pieces or end > k.MOST_PIECES:
            return
        assert fault.profile is not None
        self.pieces[self._pieces_used : end] = pieces
        plan[k.PIECES_FROM], plan[k.PIECES_TO] = self._pieces_used, end
        plan[k.OPEN_LEFT] = fault.profile.compat is not None
        plan[k.MODE], plan[k.SOURCE] = MODES[fault.profile.mode or fault.mode], k.PIECES
        otherwise = fault.profile.otherwise
        numbers[:, k.LIMIT] = math.nan if otherwise is None else otherwise
        self._pieces_used = end

    def _held(self, layout: Layout, running: Running, plan: Any, numbers: Any) -> None:
        """Values of one sender that are held; other senders stay plain."""
        held = self._known(running, plan)
        mine = {key: values for key, values in (held or {}).items() if key[2] == layout.id}
        if len(mine) != 1:
            return
        [((system, component, _, instance), values)] = mine.items()
        if instance < 0 or not all(math.isfinite(value) for value in values):
            return
        name = layout.instance or ("id" if "id" in layout.fields else "")
        if name:
            field = layout.fields[name]
            plan[k.INSTANCE_AT], plan[k.INSTANCE_SIZE] = field.offset, field.size
            plan[k.INSTANCE] = instance
        plan[k.KNOWN_SENDER] = system << 8 | component
        plan[k.MODE], plan[k.SOURCE] = k.REPLACE, k.NUMBER
        numbers[:, k.VALUE] = values

    def _noise(self, fault: Noise, plan: Any, numbers: Any) -> int | None:
        block = sum(one.block is not None for one in self._planned)
        if block == k.MOST_DRAWN or len(fault.elements) > 1:  # messages share one generator
            return None
        plan[k.SOURCE], plan[k.DRAWS_FROM] = k.DRAWN, block * k.BLOCK
        numbers[:, k.VALUE] = each(fault.value, len(numbers))
        return block

    # Before and after a stretch of forwarding

    def draw_ahead(self) -> None:
        """Fill the blocks from where the generators are now."""
        self._states = []
        for _, running, fault, block in self._planned:
            if block is None:
                continue
            rng, start = running.rng, block * k.BLOCK
            self._states.append(rng.bit_generator.state)
            self.draws[start : start + k.BLOCK] = _drawn(fault, rng, k.BLOCK)

    def settle(self) -> None:
        """Credit the faults with what was done in their name; set back their generators."""
        states = iter(self._states)
        for first, running, fault, block in self._planned:
            if first < 0:
                continue
            frames, saturated, last_us, used = (int(n) for n in self.hits[first])
            if frames:
                running.credit(frames, saturated, last_us, float(self.steps[first]))
            if block is not None:
                running.rng.bit_generator.state = next(states)
                _drawn(fault, running.rng, used)
            self.hits[first], self.steps[first] = 0, -1.0
        self._states = []


def _drawn(fault: Noise, rng: np.random.Generator, count: int) -> Any:
    """So many of a noise fault's numbers, before they are scaled; the same one by one."""
    if fault.distribution == "gaussian":
        return rng.standard_normal(count)
    return rng.uniform(-1.0, 1.0, count)
