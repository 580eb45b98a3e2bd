"""Delayed values in frames that are on time: lag, and sample and hold.

HIL_SENSOR carries several sensors and the vehicle's clock, so delaying or dropping the frame cannot
make a single sensor late or slow.
"""

from typing import Any, ClassVar

from mavproxy_fault.fault_parts.profile import CLOSE_S, Duration
from mavproxy_fault.fault_parts.value_fault import GYRO, MOST_ROWS, ValueFault
from mavproxy_fault.wire.frame import Number

Key = tuple[int, ...]
Row = tuple[float, list[Number]]
Rows = tuple[list[Row], int, int]  # the list and the valid range: first, end (exclusive)


class Lag(ValueFault, frozen=True, kw_only=True):
    """Send the values of `value` seconds ago; at first those of the fault's first frame."""

    name: ClassVar[str] = "lag"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.05}
    by_sender: ClassVar[bool] = True

    value: Duration

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Return the newest values that are at least `value` seconds old."""
        lines: dict[Key, Rows] = state or {}
        rows, old, end = lines.get(key, ([], 0, 0))
        # The list is shared with older states and grows at its end, since a copy per frame would
        # take quadratic time; it is copied when half of it is obsolete.
        if len(rows) != end or old > end // 2:
            rows, old, end = rows[old:end], 0, end - old
        rows.append((t_s, before))
        end += 1
        # The newest row that is old enough; earlier rows are obsolete.
        while old + 1 < end and rows[old + 1][0] <= t_s - self.value + CLOSE_S:
            old += 1
        old = max(old, end - MOST_ROWS)  # bounded, for a stopped clock
        return rows[old][1], {**lines, key: (rows, old, end)}


class SampleHold(ValueFault, frozen=True, kw_only=True):
    """Update the values only every `value` seconds (a slow sensor)."""

    name: ClassVar[str] = "sample-hold"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    by_sender: ClassVar[bool] = True

    value: Duration

    def after(
        self, before: list[Number], key: Key, t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Return the values of the last sample."""
        rows: dict[Key, Row] = state or {}
        sampled = rows.get(key)
        # With a tolerance, since timestamps are sums of steps.
        if sampled is not None and t_s - sampled[0] < self.value - CLOSE_S:
            return sampled[1], rows
        return before, {**rows, key: (t_s, before)}
