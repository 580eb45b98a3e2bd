"""Faults of a sensor's characteristic curve: quantisation, saturation, dead band."""

import math
from typing import Any, ClassVar

from mavproxy_fault.documents.document_check import NotNegative, Positive
from mavproxy_fault.fault_parts.rules import Numbers, RuleFault, value_rule
from mavproxy_fault.fault_parts.value_fault import GYRO


@value_rule
def round_to_step(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Round to the nearest step; NaN and infinity stay."""
    steps = x[i] / p[0]
    # Beyond 2^52 every number is whole.
    return round(steps) * p[0] if abs(steps) < 2.0**52 else x[i]


class Quantise(RuleFault, frozen=True, kw_only=True):
    """Round to steps of `value`."""

    name: ClassVar[str] = "quantise"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.25}
    aliases: ClassVar[tuple[str, ...]] = ("quantize",)
    rule = staticmethod(round_to_step)

    value: Positive


@value_rule
def limit_to_range(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Return the nearest value in the range; NaN fails both comparisons and stays."""
    return p[0] if x[i] < p[0] else p[1] if x[i] > p[1] else x[i]


class Saturate(RuleFault, frozen=True, kw_only=True):
    """Limit to the range `low` to `high`, or to plus and minus `value`."""

    name: ClassVar[str] = "saturate"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.05}
    rule = staticmethod(limit_to_range)

    value: NotNegative | None = None
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        if self.value is None and self.low is None and self.high is None:
            raise ValueError("needs at least one limit; give value, low or high")
        low, high = self._range()
        if low > high:
            raise ValueError(f"low = {low} is above high = {high}; give a low below high")

    def _range(self) -> tuple[float, float]:
        # `low` or `high` alone leaves the other side open.
        width = math.inf if self.value is None else self.value
        low = -width if self.low is None else self.low
        return low, width if self.high is None else self.high

    def numbers(self, count: int) -> list[Numbers]:
        """Return the lowest and the highest value."""
        return [self._range()] * count


@value_rule
def cut_dead_band(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Return the part outside the band; the sign stays, also that of a zero."""
    return math.copysign(max(abs(x[i]) - p[0], 0.0), x[i])


class DeadBand(RuleFault, frozen=True, kw_only=True):
    """Output zero within plus or minus `value`, and the value less the band outside."""

    name: ClassVar[str] = "dead-band"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.05}
    rule = staticmethod(cut_dead_band)

    value: NotNegative
