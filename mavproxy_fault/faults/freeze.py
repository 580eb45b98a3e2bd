"""Stale and slow values: frozen, rate-limited, or decaying to neutral."""

import math
from typing import Any, ClassVar

from mavproxy_fault.documents.document_check import NotNegative
from mavproxy_fault.fault_parts.profile import Duration
from mavproxy_fault.fault_parts.rules import Numbers, RuleFault, value_rule
from mavproxy_fault.fault_parts.value_fault import GYRO
from mavproxy_fault.faults.delayed_values import hold_sample


class Freeze(RuleFault, frozen=True, kw_only=True):
    """Hold the values of the first frame after the fault began (a stuck sensor)."""

    name: ClassVar[str] = "freeze"
    example: ClassVar[dict[str, Any]] = {"target": GYRO}
    aliases: ClassVar[tuple[str, ...]] = ("stuck",)
    by_sender: ClassVar[bool] = True
    rule = staticmethod(hold_sample)
    remembers: ClassVar[int] = 3

    def numbers(self, count: int) -> list[Numbers]:
        """Return that no new sample is taken."""
        return [(math.inf,)] * count


@value_rule
def follow_slowly(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Move from the last value, `m[2]` at `m[1]`, towards the healthy one."""
    if not m[0]:  # the first frame of a sender is unchanged, since no time has passed
        m[0], m[1], m[2] = 1.0, t_s, x[i]
    # No step if the clock goes back.
    most = p[0] * max(t_s - m[1], 0.0)
    m[1] = t_s
    m[2] += min(max(x[i] - m[2], -most), most)
    return m[2]


class SlewLimit(RuleFault, frozen=True, kw_only=True):
    """Follow the healthy value by at most `value` units per second (a weak servo)."""

    name: ClassVar[str] = "slew-limit"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.01}
    by_sender: ClassVar[bool] = True
    rule = staticmethod(follow_slowly)
    remembers: ClassVar[int] = 3

    value: NotNegative


@value_rule
def decay(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Decay exponentially from the first value, independent of the healthy ones."""
    if not m[0]:
        m[0], m[1], m[2] = 1.0, t_s, x[i]
    share = math.exp(-max(t_s - m[1], 0.0) / p[1])  # clocks may go back
    return p[0] + (m[2] - p[0]) * share


class FloatToNeutral(RuleFault, frozen=True, kw_only=True):
    """Decay to `neutral` with the time constant `settle_s` (a released actuator)."""

    name: ClassVar[str] = "float"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "settle_s": 0.05}
    by_sender: ClassVar[bool] = True
    rule = staticmethod(decay)
    parameters: ClassVar[tuple[str, ...]] = ("neutral", "settle_s")
    remembers: ClassVar[int] = 3

    neutral: float = 0.0
    settle_s: Duration = 0.2
