"""Faults written down for the compiled form: bias, scale, constant, drift, noise and freeze.

The first frame that a fault changes, and with it the label, goes the interpreted way, as do the
drawing of segments and the value that is frozen; its rows say what to do with the next ones. Noise
is drawn ahead in blocks; when the interpreted way asks for the generator, it is set back to where
the compiled form stopped, so that both give the same bytes. numpy is not loaded for this: it
would hold up the first frame on which a fault acts.
"""

import itertools
import math
from array import array
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.fault_parts.value_fault import broadcast_values
from mavproxy_fault.faults.freeze import Freeze
from mavproxy_fault.faults.noise_fault import NoiseFault
from mavproxy_fault.faults.profile_faults import Bias, Constant, Drift, ProfileFault, Scale
from mavproxy_fault.proxy.active_entry import ActiveEntry
from mavproxy_fault.wire.dialect import Layout

if TYPE_CHECKING:
    from numpy.random import Generator

MODES = {"add": k.ADD, "scale": k.SCALE, "replace": k.REPLACE}
WAYS = {"to-vehicle": 0, "from-vehicle": 1}
CODES = "bBhHiIfd"  # 64-bit integers do not fit the kernel's arithmetic
KINDS = (Bias, Scale, Constant, Drift, NoiseFault, Freeze)
Plan = list[int]  # a row, as it is made
Numbers = list[list[float]]  # VALUE and LIMIT of each element


class Planned(NamedTuple):
    """A fault of the compiled form: its first row (-1: none yet), and the block it draws from."""

    first: int
    running: ActiveEntry
    fault: Any
    stage: tuple[bool, int, bool]
    block: int | None = None


def stage(running: ActiveEntry) -> tuple[bool, int, bool]:
    """How far a fault has come: has it begun, how many states has it, is its news untold."""
    return running.first_us is not None, len(running.states), running.unannounced


class DrawnAhead:
    """Stands for a generator whose numbers lie in a block; who asks for it gets it set back."""

    def __init__(self, running: ActiveEntry, fault: NoiseFault, hits: Any, first: int) -> None:
        self._running, self._fault, self._used = running, fault, (hits, first)
        self._rng = running.rng
        self._state = self._rng.bit_generator.state  # where the block begins
        self.block = _drawn(fault, self._rng, k.BLOCK)
        hits[first, k.USED] = 0

    def __getattr__(self, name: str) -> Any:
        self.set_back()
        return getattr(self._rng, name)

    def set_back(self) -> None:
        """Set the generator back to the first unused number."""
        hits, first = self._used
        used = hits[first, k.USED]
        if used < k.BLOCK:
            self._rng.bit_generator.state = self._state
            _drawn(self._fault, self._rng, used)
        self._running.rng = self._rng


class Plans:
    """The rows of all planned faults, and the random numbers drawn ahead for them."""

    def __init__(self) -> None:
        self.rows = k.table("q", k.MOST_PLANS, k.PLAN_SIZE)
        self.numbers = k.table("d", k.MOST_PLANS, 2)
        self.hits = k.table("q", k.MOST_PLANS, 3)
        self.steps = k.table("d", k.MOST_PLANS)
        self.steps[:] = array("d", [-1.0]) * k.MOST_PLANS
        self.segments = k.table("d", k.MOST_SEGMENTS, 4)
        self.draws = k.table("d", k.MOST_DRAWN * k.BLOCK)
        self._planned: list[Planned] = []
        self._rows_used = self._segments_used = self._blocks_used = 0

    @property
    def arrays(self) -> dict[str, Any]:
        """The arrays that the machine code works on, by name."""
        return {
            "plans": self.rows, "numbers": self.numbers, "hits": self.hits, "steps": self.steps,
            "segments": self.segments, "draws": self.draws,
        }  # fmt: skip

    def clear(self) -> None:
        """Forget all rows."""
        self.set_back()
        self._planned = []
        self._rows_used = self._segments_used = self._blocks_used = 0

    @property
    def changed(self) -> bool:
        """Whether a fault has got other parameters, or has come further."""
        return any(
            one.running.fault is not one.fault or stage(one.running) != one.stage
            for one in self._planned
        )

    def add(self, layout: Layout, acting: Sequence[ActiveEntry]) -> int | None:
        """Rows for all faults that act on a message, in turn; the first row, None if one cannot."""
        used = self._rows_used, self._segments_used, self._blocks_used
        found: list[Planned] = []
        for running in acting:
            if type(running.fault) not in KINDS or running.entry.where.id is not None:
                return None
            found.append(self._one(layout, running))
        rows = [one.first for one in found]
        if min(rows) < 0 or self._entangled(rows):
            self._rows_used, self._segments_used, self._blocks_used = used
            self._planned += [one._replace(first=-1, block=None) for one in found]
            return None
        for row, following in itertools.pairwise(rows):
            self.rows[row, k.NEXT] = following
        self._planned += found
        return rows[0]

    def _entangled(self, rows: Sequence[int]) -> bool:
        """Whether a fault that has changed nothing yet shares an element with another one."""
        places = [
            {self.rows[row, k.OFFSET] for row in range(first, first + self.rows[first, k.ROWS])}
            for first in rows
        ]
        shared = len(set().union(*places)) < sum(len(one) for one in places)
        return shared and any(self.rows[row, k.WAITS] > 0 for row in rows)

    def _one(self, layout: Layout, running: ActiveEntry) -> Planned:
        """Write a fault's rows, where it can be carried out there."""
        fault, where = running.fault, running.entry.where
        elements = fault.elements.get(layout.id, ())
        first = self._rows_used
        none = Planned(-1, running, fault, stage(running))
        if (
            running.entry.probability < 1
            or layout.id in fault.factors  # its values are in another message's unit
            or first + len(elements) > k.MOST_PLANS
            or any(one.code not in CODES for one in elements)
        ):
            return none
        plan = [-1] * k.PLAN_SIZE
        plan[k.ROWS], plan[k.START] = len(elements), running.start_us
        plan[k.WAITS] = running.first_us is None or running.unannounced
        plan[k.SYSTEM : k.DIRECTION + 1] = [
            -1 if one is None else one
            for one in (where.system, where.component, WAYS.get(where.direction or ""))
        ]
        numbers: Numbers = [[0.0, 0.0] for _ in elements]
        block = self._source(layout, running, plan, numbers)
        if plan[k.SOURCE] < 0:
            return none
        _write(self.rows, first, [plan])
        _write(self.numbers, first, numbers)
        for row, one in enumerate(elements, first):
            self.rows[row, k.OFFSET], self.rows[row, k.CODE] = one.start, ord(one.code)
        self._forget_hits(first)
        self._rows_used += len(elements)
        return none._replace(first=first, block=block)

    # What meets the healthy value

    def _source(
        self, layout: Layout, running: ActiveEntry, plan: Plan, numbers: Numbers
    ) -> int | None:
        """Fill in mode, source and numbers; the source stays -1 if the fault cannot be planned."""
        fault, count = running.fault, len(numbers)
        plan[k.MODE] = k.ADD
        if isinstance(fault, Freeze):
            self._frozen(layout, running, plan, numbers)
        elif isinstance(fault, NoiseFault):
            return self._noise(fault, plan, numbers)
        elif isinstance(fault, Drift):
            plan[k.SOURCE] = k.GROWS
            _fill(numbers, k.VALUE, broadcast_values(fault.value, count))
            _fill(numbers, k.LIMIT, [math.inf if fault.limit is None else fault.limit] * count)
        elif fault.profile is None:
            plan[k.MODE], plan[k.SOURCE] = MODES[fault.mode], k.NUMBER
            _fill(numbers, k.VALUE, broadcast_values(fault.value, count))
        elif fault.profile.segments is not None:
            self._segments(fault, running, plan, numbers)
        return None

    def _known(self, running: ActiveEntry, plan: Plan) -> Any:
        """The fault's state if it has only one; frames of the other direction are handed over."""
        if len(running.states) != 1:
            return None
        [(way, state)] = running.states.items()
        plan[k.KNOWN_WAY] = WAYS[way]
        return state.inner

    def _segments(
        self, fault: ProfileFault, running: ActiveEntry, plan: Plan, numbers: Numbers
    ) -> None:
        drawn = self._known(running, plan)
        end = self._segments_used + len(drawn or ())
        if not drawn or end > k.MOST_SEGMENTS:
            return
        assert fault.profile is not None
        _write(self.segments, self._segments_used, drawn)
        plan[k.SEGMENTS_FROM], plan[k.SEGMENTS_TO] = self._segments_used, end
        plan[k.OPEN_LEFT] = fault.profile.compat is not None
        plan[k.MODE], plan[k.SOURCE] = MODES[fault.profile.mode or fault.mode], k.SEGMENTS
        otherwise = fault.profile.otherwise
        _fill(numbers, k.LIMIT, [math.nan if otherwise is None else otherwise] * len(numbers))
        self._segments_used = end

    def _frozen(self, layout: Layout, running: ActiveEntry, plan: Plan, numbers: Numbers) -> None:
        """Frozen values of one sender; other senders are handed over."""
        frozen = self._known(running, plan)
        mine = {key: values for key, values in (frozen or {}).items() if key[2] == layout.id}
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
        _fill(numbers, k.VALUE, values)

    def _noise(self, fault: NoiseFault, plan: Plan, numbers: Numbers) -> int | None:
        block = self._blocks_used
        if block == k.MOST_DRAWN or len(fault.elements) > 1:  # messages share one generator
            return None
        plan[k.SOURCE], plan[k.DRAWS_FROM] = k.DRAWN, block * k.BLOCK
        _fill(numbers, k.VALUE, broadcast_values(fault.value, len(numbers)))
        self._blocks_used += 1
        return block

    # Before and after a stretch of forwarding

    def draw_ahead(self) -> None:
        """Fill the blocks whose generators the interpreted way has had meanwhile."""
        for first, running, fault, _, block in self._planned:
            if block is not None and not isinstance(running.rng, DrawnAhead):
                ahead = DrawnAhead(running, fault, self.hits, first)
                self.draws[block * k.BLOCK : (block + 1) * k.BLOCK] = ahead.block
                running.rng = cast("Generator", ahead)

    def set_back(self) -> None:
        """Set all generators back to their first unused numbers."""
        for one in self._planned:
            if isinstance(one.running.rng, DrawnAhead):
                one.running.rng.set_back()

    def settle(self) -> None:
        """Add the counts of the compiled code to the faults."""
        for first, running, *_ in self._planned:
            if first >= 0 and self.hits[first, k.FRAMES_HIT]:
                frames, saturated = self.hits[first, k.FRAMES_HIT], self.hits[first, k.SATURATED]
                running.count_frames(frames, saturated, self.steps[first])
                self._forget_hits(first)

    def _forget_hits(self, first: int) -> None:
        self.hits[first, k.FRAMES_HIT] = self.hits[first, k.SATURATED] = 0
        self.steps[first] = -1.0


def _write(table: Any, first: int, rows: Sequence[Sequence[float]]) -> None:
    """Put rows into a table from one of its rows on."""
    for row, values in enumerate(rows, first):
        for column, value in enumerate(values):
            table[row, column] = value


def _fill(numbers: Numbers, column: int, values: Sequence[float]) -> None:
    """Set a number of each element."""
    for row, value in zip(numbers, values, strict=True):
        row[column] = value


def _drawn(fault: NoiseFault, rng: "Generator", count: int) -> Any:
    """Draw `count` unscaled numbers of a noise fault; the same as drawing them one by one."""
    if fault.distribution == "gaussian":
        return rng.standard_normal(count)
    return rng.uniform(-1.0, 1.0, count)
