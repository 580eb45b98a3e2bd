"""Values of the past: held, played again, or following too slowly."""

import math
from typing import Any, ClassVar

from mavproxy_fault.fault_parts.profile import Duration, NotNegative
from mavproxy_fault.fault_parts.value_fault import GYRO, MOST_ROWS, ValueFault
from mavproxy_fault.wire.frame import Number

Key = tuple[int, ...]


class Freeze(ValueFault, frozen=True, kw_only=True):
    """Hold the values of the first frame after the fault began (a stuck sensor)."""

    name: ClassVar[str] = "freeze"
    example: ClassVar[dict[str, Any]] = {"target": GYRO}
    aliases: ClassVar[tuple[str, ...]] = ("stuck",)
    by_sender: ClassVar[bool] = True

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """The values of this sender's first frame."""
        frozen: dict[Key, list[Number]] = state or {}
        if key in frozen:
            return frozen[key], frozen
        # A new dictionary: states that were handed out earlier stay as they are.
        return before, {**frozen, key: before}


class Replay(ValueFault, frozen=True, kw_only=True):
    """Let the first `value` seconds pass, then play them again and again."""

    name: ClassVar[str] = "replay"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    by_sender: ClassVar[bool] = True

    value: Duration

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """The next recorded values of this sender."""
        tapes: dict[Key, tuple[list[list[Number]], int]] = state or {}
        tape, at = tapes.get(key, ([], 0))
        # Where the clock stands still, the tape ends when it is full.
        if (t_s < self.value and len(tape) < MOST_ROWS) or not tape:
            # Appending to the list of the old state would alter it; a copy per frame would cost
            # time quadratic in the stretch. The tape only grows at its end and is read up to `at`.
            tape = [*tape, before] if len(tape) != at else _appended(tape, before)
            return before, {**tapes, key: (tape, len(tape))}
        return tape[at % len(tape)], {**tapes, key: (tape, at + 1)}


def _appended(tape: list[list[Number]], values: list[Number]) -> list[list[Number]]:
    tape.append(values)
    return tape


class SlewLimit(ValueFault, frozen=True, kw_only=True):
    """Follow the healthy value by at most `value` units per second (a weak servo)."""

    name: ClassVar[str] = "slew-limit"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.01}
    by_sender: ClassVar[bool] = True

    value: NotNegative

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """One step towards the healthy value."""
        last: dict[Key, tuple[float, list[Number]]] = state or {}
        # The first frame of a sender: no time has passed, so it passes unchanged.
        last_s, previous = last.get(key, (t_s, before))
        # A clock that goes back gives no step at all.
        most = self.value * max(t_s - last_s, 0.0)
        now = [h + min(max(x - h, -most), most) for x, h in zip(before, previous, strict=True)]
        return now, {**last, key: (t_s, now)}


class FloatToNeutral(ValueFault, frozen=True, kw_only=True):
    """Let go of the value: it falls back to `neutral` with the time constant `settle_s`."""

    name: ClassVar[str] = "float"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "settle_s": 0.05}
    by_sender: ClassVar[bool] = True

    neutral: float = 0.0
    settle_s: Duration = 0.2

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """An exponential from where the fault found it; the healthy value no longer matters."""
        found: dict[Key, tuple[float, list[Number]]] = state or {}
        start_s, start = found.get(key, (t_s, before))
        share = math.exp(-max(t_s - start_s, 0.0) / self.settle_s)  # clocks may go back
        now = [self.neutral + (x - self.neutral) * share for x in start]
        return now, {**found, key: (start_s, start)}
