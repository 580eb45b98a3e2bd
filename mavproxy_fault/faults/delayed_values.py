"""Delayed values in frames that are on time: lag, replay, and sample and hold.

HIL_SENSOR carries several sensors and the vehicle's clock, so delaying or dropping the frame cannot
make a single sensor late or slow.
"""

from typing import Any, ClassVar

from mavproxy_fault.fault_parts.profile import CLOSE_S, Duration
from mavproxy_fault.fault_parts.rules import Numbers, RuleFault, value_rule
from mavproxy_fault.fault_parts.value_fault import GYRO, MOST_ROWS

FASTEST_HZ = 1200.0  # of frames whose values are remembered; IMUs publish at up to 1 kHz


def stored_rows(span_s: float) -> int:
    """Return how many past values of a time are kept; a bound for a stopped clock, too."""
    return min(int(span_s * FASTEST_HZ) + 8, MOST_ROWS)


class StoredValues(RuleFault, frozen=True, kw_only=True):
    """Base of faults that remember the values of `value` seconds, in `width` numbers each."""

    by_sender: ClassVar[bool] = True
    width: ClassVar[int]

    value: Duration

    @property
    def remembers(self) -> int:  # type: ignore[override]
        """Two places in the stored values, and those."""
        return 2 + self.width * stored_rows(self.value)

    def numbers(self, count: int) -> list[Numbers]:
        """Return the time and how many values are stored."""
        return [(self.value, float(stored_rows(self.value)))] * count


@value_rule
def delay_value(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Return the newest value that is old enough, from a ring of `m[0]` times and values."""
    rows, count, first = int(p[1]), int(m[0]), int(m[1])
    if count == rows:
        first, count = (first + 1) % rows, count - 1
    slot = 2 + 2 * ((first + count) % rows)
    m[slot], m[slot + 1] = t_s, x[i]
    count += 1
    while count > 1 and m[2 + 2 * ((first + 1) % rows)] <= t_s - p[0] + CLOSE_S:
        first, count = (first + 1) % rows, count - 1
    m[0], m[1] = float(count), float(first)
    return m[3 + 2 * first]


class Lag(StoredValues, frozen=True, kw_only=True):
    """Send the values of `value` seconds ago; at first those of the fault's first frame."""

    name: ClassVar[str] = "lag"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.05}
    width: ClassVar[int] = 2  # with their times
    rule = staticmethod(delay_value)


@value_rule
def repeat_recording(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Record `m[0]` values, then return them in turn."""
    count = int(m[0])
    if count == 0 or (t_s < p[0] and count < p[1]):
        m[2 + count] = x[i]
        m[0] = float(count + 1)
        return x[i]
    m[1] = (m[1] + 1.0) % count
    return m[2 + int(m[1] + count - 1.0) % count]


class Replay(StoredValues, frozen=True, kw_only=True):
    """Record the first `value` seconds, then replay them in a loop."""

    name: ClassVar[str] = "replay"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    width: ClassVar[int] = 1
    rule = staticmethod(repeat_recording)


@value_rule
def hold_sample(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Return the last sample, `m[2]` of `m[1]`, or take a new one."""
    # With a tolerance, since timestamps are sums of steps.
    if not m[0] or not t_s - m[1] < p[0] - CLOSE_S:
        m[0], m[1], m[2] = 1.0, t_s, x[i]
    return m[2]


class SampleHold(RuleFault, frozen=True, kw_only=True):
    """Update the values only every `value` seconds (a slow sensor)."""

    name: ClassVar[str] = "sample-hold"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    by_sender: ClassVar[bool] = True
    rule = staticmethod(hold_sample)
    remembers: ClassVar[int] = 3

    value: Duration
