"""Values that are late while their frames are not: lag, and sample and hold.

HIL_SENSOR carries several sensors and the vehicle's clock, so that one of its sensors cannot be
late or slow by delaying or losing the frame.
"""

from typing import Any, ClassVar

from mavproxy_fault.fault_parts.profile import CLOSE_S, Duration
from mavproxy_fault.fault_parts.value_fault import GYRO, MOST_ROWS, ValueFault
from mavproxy_fault.wire.frame import Number

Key = tuple[int, ...]
Row = tuple[float, list[Number]]
Rows = tuple[list[Row], int, int]  # which of them count: from the one to before the other


class Lag(ValueFault, frozen=True, kw_only=True):
    """Send the values of `value` seconds ago; until then those of the fault's first frame."""

    name: ClassVar[str] = "lag"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.05}
    by_sender: ClassVar[bool] = True

    value: Duration

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """The newest values that are old enough."""
        lines: dict[Key, Rows] = state or {}
        rows, old, end = lines.get(key, ([], 0, 0))
        # The list only grows at its end, as a copy with each frame would cost time quadratic in the
        # stretch; now and then it is copied without what is no longer needed.
        if len(rows) != end or old > end // 2:
            rows, old, end = rows[old:end], 0, end - old
        rows.append((t_s, before))
        end += 1
        # The newest row that is as old as asked for; rows before it are never needed again.
        while old + 1 < end and rows[old + 1][0] <= t_s - self.value + CLOSE_S:
            old += 1
        old = max(old, end - MOST_ROWS)  # of a clock that stands still none gets old
        return rows[old][1], {**lines, key: (rows, old, end)}


class SampleHold(ValueFault, frozen=True, kw_only=True):
    """Take new values only every `value` seconds (a slow sensor)."""

    name: ClassVar[str] = "sample-hold"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    by_sender: ClassVar[bool] = True

    value: Duration

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """The values of the last sample."""
        rows: dict[Key, Row] = state or {}
        sampled = rows.get(key)
        # Within rounding of the period counts as the period: stamps are sums of steps.
        if sampled is not None and t_s - sampled[0] < self.value - CLOSE_S:
            return sampled[1], rows
        return before, {**rows, key: (t_s, before)}
