"""Values that are late while their frames are not: lag, and sample and hold.

HIL_SENSOR carries several sensors and the vehicle's clock, so that one of its sensors cannot be
late or slow by delaying or losing the frame.
"""

from typing import Any, ClassVar

from mavproxy_fault.fault_parts.profile import CLOSE_S, Duration
from mavproxy_fault.fault_parts.value_fault import GYRO, ValueFault
from mavproxy_fault.wire.frame import Number

Key = tuple[int, ...]
ROWS_MAX = 65_536  # per sender; 65 s at 1 kHz
Row = tuple[float, list[Number]]


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
        rows: dict[Key, tuple[Row, ...]] = state or {}
        past = (*rows.get(key, ()), (t_s, before))[-ROWS_MAX:]
        # The newest row that is as old as asked for; rows before it are never needed again.
        old = 0
        while old + 1 < len(past) and past[old + 1][0] <= t_s - self.value + CLOSE_S:
            old += 1
        return past[old][1], {**rows, key: past[old:]}


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
