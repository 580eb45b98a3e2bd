"""Periodic faults: a sine, an impulse train, a bias that moves from element to element."""

import math
from typing import Any, ClassVar

from mavproxy_fault.documents.document_check import Positive
from mavproxy_fault.fault_parts.profile import (
    CLOSE_S,
    IMPULSES,
    MODES,
    Duration,
    Mode,
)
from mavproxy_fault.fault_parts.rules import Numbers, RuleFault, value_rule
from mavproxy_fault.fault_parts.value_fault import GYRO, GYROS
from mavproxy_fault.faults.profile_faults import combine_profile


@value_rule
def add_sine(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Add the sine, with the same phase on every element."""
    return x[i] + p[0] * math.sin(math.tau * p[1] * t_s + p[2])


class SineWave(RuleFault, frozen=True, kw_only=True):
    """Add a sine of amplitude `value` and `frequency_hz` (vibration)."""

    name: ClassVar[str] = "sine"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1, "frequency_hz": 10}
    on_ranges: ClassVar[bool] = True
    rule = staticmethod(add_sine)
    parameters: ClassVar[tuple[str, ...]] = ("value", "frequency_hz", "phase_rad")

    value: float
    frequency_hz: Positive
    phase_rad: float = 0.0


class Impulse(RuleFault, frozen=True, kw_only=True):
    """Apply an impulse train of height `value`: `width_s` long, every `period_s`."""

    name: ClassVar[str] = "impulse"
    example: ClassVar[dict[str, Any]] = {
        "target": GYRO, "value": 5.0, "period_s": 0.1, "width_s": 0.02,
    }  # fmt: skip
    on_ranges: ClassVar[bool] = True
    rule = staticmethod(combine_profile)

    value: float
    period_s: Duration
    width_s: Duration
    mode: Mode = "add"

    def __post_init__(self) -> None:
        # An impulse as long as the period would be a bias.
        if self.width_s >= self.period_s:
            raise ValueError(
                f"width_s = {self.width_s} must be shorter than period_s = {self.period_s}"
            )

    def numbers(self, count: int) -> list[Numbers]:
        """Return those of a profile of impulses, between which the value is healthy."""
        train = self.value, self.period_s, self.width_s
        return [(MODES[self.mode], IMPULSES, 0.0, 0.0, *train)] * count


@value_rule
def add_to_one(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Add the error to the element of the current period."""
    # By time, so that lost frames do not shift the cycle.
    active = int((t_s + CLOSE_S) / p[1]) % int(p[2])
    return x[i] + p[0] if i == active else x[i]


class Cycle(RuleFault, frozen=True, kw_only=True):
    """Add `value` to one element (or satellite) after another, each for `period_s`."""

    name: ClassVar[str] = "cycle"
    example: ClassVar[dict[str, Any]] = {"target": GYROS, "value": 1.0, "period_s": 0.1}
    on_ranges: ClassVar[bool] = True
    rule = staticmethod(add_to_one)

    value: float
    period_s: Duration

    def numbers(self, count: int) -> list[Numbers]:
        """Return the error, the period and the number of elements."""
        return [(self.value, self.period_s, float(count))] * count
