"""Delayed values in frames that are on time: lag, and sample and hold.

HIL_SENSOR carries several sensors and the vehicle's clock, so delaying or dropping the frame cannot
make a single sensor late or slow.
"""

from typing import Any, ClassVar

from mavproxy_fault.fault_parts.profile import CLOSE_S, Duration
from mavproxy_fault.fault_parts.rules import Numbers, RuleFault, value_rule
from mavproxy_fault.fault_parts.value_fault import GYRO, MOST_ROWS, ValueFault
from mavproxy_fault.wire.frame import Number

Key = tuple[int, ...]
Rows = tuple[
    list[tuple[float, list[Number]]], int, int
]  # the list and the valid range: first, end (exclusive)


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


@value_rule
def hold_sample(
    x: Any, i: int, t_s: float, p: Numbers, at: int, m: Any, place: int, u: float
) -> Any:
    """Return the last sample, `m[place + 2]` of `m[place + 1]`, or take a new one."""
    # With a tolerance, since timestamps are sums of steps.
    if not m[place] or not t_s - m[place + 1] < p[at] - CLOSE_S:
        m[place], m[place + 1], m[place + 2] = 1.0, t_s, x[i]
    return m[place + 2]


class SampleHold(RuleFault, frozen=True, kw_only=True):
    """Update the values only every `value` seconds (a slow sensor)."""

    name: ClassVar[str] = "sample-hold"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    by_sender: ClassVar[bool] = True
    rule = staticmethod(hold_sample)
    remembers: ClassVar[int] = 3

    value: Duration

    def numbers(self, count: int) -> list[Numbers]:
        """Return the interval."""
        return [(self.value,)] * count
