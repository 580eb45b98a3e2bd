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

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """The nearest step."""
        step = self.value
        # NaN and infinity have no nearest step.
        return [round(x / step) * step if math.isfinite(x) else x for x in before], None


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

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """The nearest value within the range."""
        low, high = self._range()
        # NaN is neither within nor beyond, and passes.
        return [x if low <= x <= high else min(max(x, low), high) for x in before], None


class DeadBand(ValueFault, frozen=True, kw_only=True):
    """Nothing (zero) within plus or minus `value`; outside, the value less the band."""

    name: ClassVar[str] = "dead-band"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.05}

    value: NotNegative

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """What stands out of the band."""
        band = self.value
        # The sign stays, also of a zero.
        return [math.copysign(max(abs(x) - band, 0.0), x) for x in before], None
