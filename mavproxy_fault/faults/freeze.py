"""Stale and slow values: frozen, replayed, rate-limited, or decaying to neutral."""

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
        """Return the values of this sender's first frame."""
        frozen: dict[Key, list[Number]] = state or {}
        if key in frozen:
            return frozen[key], frozen
        # A new dictionary, since earlier states must not change.
        return before, {**frozen, key: before}


class Replay(ValueFault, frozen=True, kw_only=True):
    """Record the first `value` seconds, then replay them in a loop."""

    name: ClassVar[str] = "replay"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    by_sender: ClassVar[bool] = True

    value: Duration

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Return the next recorded values of this sender."""
        recordings: dict[Key, tuple[list[list[Number]], int]] = state or {}
        recording, at = recordings.get(key, ([], 0))
        # A stopped clock ends the recording when it is full.
        if (t_s < self.value and len(recording) < MOST_ROWS) or not recording:
            # The list is shared with older states, which read up to their own `at`: a copy per
            # frame would take quadratic time.
            shared = len(recording) != at
            recording = [*recording, before] if shared else _append_row(recording, before)
            return before, {**recordings, key: (recording, len(recording))}
        return recording[at % len(recording)], {**recordings, key: (recording, at + 1)}


def _append_row(recording: list[list[Number]], values: list[Number]) -> list[list[Number]]:
    recording.append(values)
    return recording


class SlewLimit(ValueFault, frozen=True, kw_only=True):
    """Follow the healthy value by at most `value` units per second (a weak servo)."""

    name: ClassVar[str] = "slew-limit"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.01}
    by_sender: ClassVar[bool] = True

    value: NotNegative

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Move towards the healthy values at the limited rate."""
        last: dict[Key, tuple[float, list[Number]]] = state or {}
        # The first frame of a sender is unchanged, since no time has passed.
        last_s, previous = last.get(key, (t_s, before))
        # No step if the clock goes back.
        most = self.value * max(t_s - last_s, 0.0)
        now = [h + min(max(x - h, -most), most) for x, h in zip(before, previous, strict=True)]
        return now, {**last, key: (t_s, now)}


class FloatToNeutral(ValueFault, frozen=True, kw_only=True):
    """Decay to `neutral` with the time constant `settle_s` (a released actuator)."""

    name: ClassVar[str] = "float"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "settle_s": 0.05}
    by_sender: ClassVar[bool] = True

    neutral: float = 0.0
    settle_s: Duration = 0.2

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Decay exponentially from the first values, independent of the healthy ones."""
        starts: dict[Key, tuple[float, list[Number]]] = state or {}
        start_s, start = starts.get(key, (t_s, before))
        share = math.exp(-max(t_s - start_s, 0.0) / self.settle_s)  # clocks may go back
        now = [self.neutral + (x - self.neutral) * share for x in start]
        return now, {**starts, key: (start_s, start)}
