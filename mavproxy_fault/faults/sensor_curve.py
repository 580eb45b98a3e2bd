"""Faults of a sensor's characteristic curve: quantisation, saturation, dead band."""

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
        """Round to the nearest step."""
        # NaN and infinity stay.
        return round(healthy / self.value) * self.value if math.isfinite(healthy) else healthy


class Saturate(ValueFault, frozen=True, kw_only=True):
    """Limit to the range `low` to `high`, or to plus and minus `value`."""

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
            raise ValueError(f"low = {low} is above high = {high}; give a low below high")

    def _range(self) -> tuple[float, float]:
        # `low` or `high` alone leaves the other side open.
        width = math.inf if self.value is None else self.value
        low = -width if self.low is None else self.low
        return low, width if self.high is None else self.high

    def of(self, healthy: Number, t_s: float) -> Number:
        """Return the nearest value in the range."""
        low, high = self._range()
        # NaN fails both comparisons and stays.
        return low if healthy < low else high if healthy > high else healthy


class DeadBand(ValueFault, frozen=True, kw_only=True):
    """Output zero within plus or minus `value`, and the value less the band outside."""

    name: ClassVar[str] = "dead-band"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.05}

    value: NotNegative

    def of(self, healthy: Number, t_s: float) -> Number:
        """Return the part outside the band."""
        # The sign stays, also that of a zero.
        return math.copysign(max(abs(healthy) - self.value, 0.0), healthy)
