"""A sensor's characteristic curve gone wrong: coarse steps, too small a range, a dead band."""

import math
from typing import Any, ClassVar

from mavproxy_fault.fault_parts.profile import NotNegative, Positive
from mavproxy_fault.fault_parts.value_fault import GYRO, ValueFault
from mavproxy_fault.wire.frame import Number


class Quantise(ValueFault, frozen=True, kw_only=True):
    """Round to steps of `value`."""

    name: ClassVar[str] = "quantise"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.25}
    aliases: ClassVar[tuple[str, ...]] = ("quantize",)

    value: Positive

    def of(self, healthy: Number, t_s: float) -> Number:
        """The nearest step."""
        # NaN and infinity have no nearest step.
        return round(healthy / self.value) * self.value if math.isfinite(healthy) else healthy


class Saturate(ValueFault, frozen=True, kw_only=True):
    """Limit to a range, `low` to `high` (plus and minus `value` if only that is given)."""

    name: ClassVar[str] = "saturate"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.05}

    value: NotNegative | None = None
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        if self.value is None and self.low is None and self.high is None:
            raise ValueError("needs a range; give value, low or high")
        low, high = self._range()
        if low > high:
            raise ValueError(f"low = {low} is above high = {high}; the range must not be empty")

    def _range(self) -> tuple[float, float]:
        # One number gives both sides; `low` or `high` alone leaves the other side open.
        width = math.inf if self.value is None else self.value
        low = -width if self.low is None else self.low
        return low, width if self.high is None else self.high

    def of(self, healthy: Number, t_s: float) -> Number:
        """The nearest value within the range."""
        low, high = self._range()
        # NaN is neither beyond the one nor the other, and passes.
        return low if healthy < low else high if healthy > high else healthy


class DeadBand(ValueFault, frozen=True, kw_only=True):
    """Nothing (zero) within plus or minus `value`; outside, the value less the band."""

    name: ClassVar[str] = "dead-band"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.05}

    value: NotNegative

    def of(self, healthy: Number, t_s: float) -> Number:
        """What stands out of the band."""
        # The sign stays, also of a zero.
        return math.copysign(max(abs(healthy) - self.value, 0.0), healthy)
