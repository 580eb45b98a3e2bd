"""White noise and random walk."""

import math
from typing import Any, ClassVar, Literal

from mavproxy_fault.documents.document_check import NotNegative
from mavproxy_fault.fault_parts.rules import Drawn, Numbers, RuleFault, value_rule
from mavproxy_fault.fault_parts.value_fault import GYRO, broadcast_values


@value_rule
def add_noise(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Add a Gaussian number, or one that is uniform between -1 and 1, times sigma or width."""
    return x[i] + (2.0 * u - 1.0 if p[1] else u) * p[0]


class NoiseFault(RuleFault, frozen=True, kw_only=True):
    """Add white noise: Gaussian with sigma `value`, or uniform within plus or minus `value`."""

    name: ClassVar[str] = "noise"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    on_ranges: ClassVar[bool] = True
    rule = staticmethod(add_noise)

    value: NotNegative | tuple[NotNegative, ...]
    distribution: Literal["gaussian", "uniform"] = "gaussian"

    @property
    def drawn(self) -> Drawn:  # type: ignore[override]
        """One for each element."""
        return "random" if self.distribution == "uniform" else "standard_normal"

    def numbers(self, count: int) -> list[Numbers]:
        """Return the size, and whether the noise is uniform."""
        uniform = float(self.distribution == "uniform")
        return [(size, uniform) for size in broadcast_values(self.value, count)]


@value_rule
def walk(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Add the walk `m[1]` after a step for the time since `m[0]`."""
    # Variance grows with time, not with frames, so lost frames do not slow the walk.
    sigma = p[0] * math.sqrt(max(t_s - m[0], 0.0))
    m[0] = t_s
    m[1] += u * sigma
    return x[i] + m[1]


class RandomWalk(RuleFault, frozen=True, kw_only=True):
    """Add a Wiener process: its sigma is `value` times the square root of the elapsed seconds."""

    name: ClassVar[str] = "random-walk"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    on_ranges: ClassVar[bool] = True
    by_sender: ClassVar[bool] = True
    rule = staticmethod(walk)
    remembers: ClassVar[int] = 2
    drawn: ClassVar[Drawn] = "standard_normal"

    value: NotNegative
