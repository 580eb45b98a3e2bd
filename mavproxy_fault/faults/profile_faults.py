"""Bias, scale, constant and drift: a number or a profile combined with the healthy value."""

from typing import Any, ClassVar

from mavproxy_fault.documents.document_check import NotFinite
from mavproxy_fault.fault_parts.profile import Mode, Profile
from mavproxy_fault.fault_parts.value_fault import GYRO, ValueFault, ValueState, broadcast_values
from mavproxy_fault.wire.frame import Number


class ProfileFault(ValueFault, frozen=True, kw_only=True):
    """Base of faults with a number (or one for each element) or a profile."""

    mode: ClassVar[Mode]

    value: NotFinite | tuple[NotFinite, ...] | None = None
    profile: Profile | None = None

    def __post_init__(self) -> None:
        if (self.value is None) == (self.profile is None):
            raise ValueError("needs exactly one of value and profile")
        super().__post_init__()

    @property
    def by_value(self) -> bool:
        """Whether one number applies to all elements."""
        return super().by_value and isinstance(self.value, int | float)

    def of(self, healthy: Number, t_s: float) -> Number:
        """Combine one healthy value with the number."""
        assert not isinstance(self.value, tuple | None)
        return combine_values(self.mode, healthy, self.value)

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Combine the healthy values with the numbers or the profile."""
        if self.profile is None:
            assert self.value is not None
            values = broadcast_values(self.value, len(before))
            return [
                combine_values(self.mode, x, y) for x, y in zip(before, values, strict=True)
            ], None
        if state is None:
            state = self.profile.new_state(rng)
        current = self.profile.value(t_s, state)
        if current is None:
            return before, state
        # The profile's mode takes precedence: `mode: replace` in a bias.
        mode = self.profile.mode or self.mode
        return [combine_values(mode, x, current) for x in before], state

    def fed(self, state: ValueState, value: float, t_us: int) -> ValueState:
        """Return the state after a live value that arrived at `t_us`."""
        # With the time since the start, for the timeout of live profiles.
        return ValueState(state.start_us, ((t_us - state.start_us) / 1e6, value))


def combine_values(mode: Mode, healthy: Number, value: float) -> Number:
    """Add, scale or replace the healthy value."""
    if mode == "add":
        return healthy + value
    return healthy * value if mode == "scale" else value


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


class Drift(ValueFault, frozen=True, kw_only=True):
    """Add an error that grows by `value` units per second, up to `limit`."""

    name: ClassVar[str] = "drift"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 10.0}
    aliases: ClassVar[tuple[str, ...]] = ("ramp",)
    on_ranges: ClassVar[bool] = True

    value: float | tuple[float, ...]
    limit: float | None = None

    @property
    def by_value(self) -> bool:
        """Whether one rate applies to all elements."""
        return super().by_value and not isinstance(self.value, tuple)

    def of(self, healthy: Number, t_s: float) -> Number:
        """Add rate times time."""
        assert not isinstance(self.value, tuple)
        grown = self.value * t_s
        # The limit applies to the error, not to the value.
        if self.limit is not None:
            grown = max(-self.limit, min(self.limit, grown))
        return healthy + grown

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Add rate times time."""
        rates = broadcast_values(self.value, len(before))
        if self.limit is not None:
            grown = [max(-self.limit, min(self.limit, rate * t_s)) for rate in rates]
            return [x + grown[n] for n, x in enumerate(before)], None
        return [x + rates[n] * t_s for n, x in enumerate(before)], None
