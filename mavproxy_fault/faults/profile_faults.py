"""Bias, scale, constant and drift: a number or a profile combined with the healthy value."""

import math
from collections.abc import Sequence
from typing import Any, ClassVar

from mavproxy_fault.documents.document_check import NotFinite
from mavproxy_fault.fault_parts.memory import Memory
from mavproxy_fault.fault_parts.profile import (
    MODES,
    Mode,
    Profile,
    hold_live_value,
    profile_value,
)
from mavproxy_fault.fault_parts.rules import Numbers, Rule, RuleFault, value_rule
from mavproxy_fault.fault_parts.value_fault import GYRO, ValueState, broadcast_values
from mavproxy_fault.wire.frame import Number


@value_rule
def combine_number(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Add the number, scale by it, or replace by it."""
    if p[0] == 0.0:
        return x[i] + p[1]
    return x[i] * p[1] if p[0] == 1.0 else p[1]


@value_rule
def combine_profile(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Combine the healthy value with the profile's by the mode `p[0]`; `m` is its memory."""
    held, value = profile_value(p[1:], t_s, m)
    return combine_number(x, i, t_s, (p[0], value), m, u) if held else x[i]


class ProfileFault(RuleFault, frozen=True, kw_only=True):
    """Base of faults with a number (or one for each element) or a profile."""

    mode: ClassVar[Mode]

    value: NotFinite | tuple[NotFinite, ...] | None = None
    profile: Profile | None = None

    def __post_init__(self) -> None:
        if (self.value is None) == (self.profile is None):
            raise ValueError("needs exactly one of value and profile")
        super().__post_init__()

    @property
    def rule(self) -> Rule | None:
        """That of the number or of the profile; None for a series, which is read from a file."""
        if self.profile is None:
            return combine_number
        return combine_profile if self.profile.table is None else None

    def numbers(self, count: int) -> list[Numbers]:
        """Return mode and number, or mode and numbers of the profile."""
        if self.profile is None:
            assert self.value is not None
            return [(MODES[self.mode], y) for y in broadcast_values(self.value, count)]
        # The profile's mode takes precedence: `mode: replace` in a bias.
        return [(MODES[self.profile.mode or self.mode], *self.profile.numbers)] * count

    def new_memory(self, count: int, rng: Any) -> Memory:
        """Return a profile's memory, with its random numbers drawn."""
        return super().new_memory(count, rng) if self.profile is None else self.profile.memory(rng)

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[Sequence[Number], Any]:
        """Combine the healthy values with the numbers or the profile."""
        if self.profile is None or self.profile.table is None:
            return super().after(before, key, t_s, state, rng)
        if state is None:
            state = self.profile.new_state(rng)
        value = self.profile.value(t_s, state)
        numbers = (MODES[self.profile.mode or self.mode], math.nan if value is None else value)
        if value is None:
            return before, state
        return [combine_number(before, i, t_s, numbers, (), 0.0)
                for i in range(len(before))], state  # fmt: skip

    def fed(self, state: ValueState, value: float, t_us: int) -> ValueState:
        """Return the state after a live value that arrived at `t_us`."""
        memory = None if state.inner is None else state.inner[()]
        held = hold_live_value(memory, state.start_us, t_us, value)
        return ValueState(state.start_us, {(): held})


class Bias(ProfileFault, frozen=True, kw_only=True):
    """Add a constant, or a profile, to the healthy value."""

    name: ClassVar[str] = "bias"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 1.0}
    on_ranges: ClassVar[bool] = True
    mode: ClassVar[Mode] = "add"


class Scale(ProfileFault, frozen=True, kw_only=True):
    """Multiply the healthy value by a factor, or by a profile."""

    name: ClassVar[str] = "scale"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 2.0}
    mode: ClassVar[Mode] = "scale"


class Constant(ProfileFault, frozen=True, kw_only=True):
    """Replace the healthy value by a constant, or by a profile."""

    name: ClassVar[str] = "constant"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 3.0}
    mode: ClassVar[Mode] = "replace"


@value_rule
def add_growth(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Add rate times time; the limit applies to the error, not to the value."""
    return x[i] + max(-p[1], min(p[1], p[0] * t_s))


class Drift(RuleFault, frozen=True, kw_only=True):
    """Add an error that grows by `value` units per second, up to `limit`."""

    name: ClassVar[str] = "drift"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 10.0}
    aliases: ClassVar[tuple[str, ...]] = ("ramp",)
    on_ranges: ClassVar[bool] = True

    value: float | tuple[float, ...]
    limit: float | None = None
    rule = staticmethod(add_growth)

    def numbers(self, count: int) -> list[Numbers]:
        """Return rate and limit."""
        limit = math.inf if self.limit is None else self.limit
        return [(rate, limit) for rate in broadcast_values(self.value, count)]
