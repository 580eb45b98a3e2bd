"""Periodic faults: a sine, an impulse train, one element after another."""

import math
from typing import Any, ClassVar

from mavproxy_fault.fault_parts.profile import CLOSE_S, Duration, Mode, Positive, time_since_period
from mavproxy_fault.fault_parts.value_fault import ValueFault
from mavproxy_fault.faults.profile_faults import combine_values
from mavproxy_fault.wire.frame import Number


class SineWave(ValueFault, frozen=True, kw_only=True):
    """Add a sine of amplitude `value` and `frequency_hz` (vibration)."""

    name: ClassVar[str] = "sine"
    example: ClassVar[dict[str, Any]] = {
        "target": "HIL_SENSOR.xgyro",
        "value": 0.1,
        "frequency_hz": 10,
    }
    on_ranges: ClassVar[bool] = True

    value: float
    frequency_hz: Positive
    phase_rad: float = 0.0

    def of(self, healthy: Number, t_s: float) -> Number:
        """Add the sine, with the same phase on every element."""
        phase_rad = math.tau * self.frequency_hz * t_s + self.phase_rad
        return healthy + self.value * math.sin(phase_rad)


class Impulse(ValueFault, frozen=True, kw_only=True):
    """Apply an impulse train of height `value`: `width_s` long, every `period_s`."""

    name: ClassVar[str] = "impulse"
    example: ClassVar[dict[str, Any]] = {
        "target": "HIL_SENSOR.xgyro",
        "value": 5.0,
        "period_s": 0.1,
        "width_s": 0.02,
    }
    on_ranges: ClassVar[bool] = True

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

    def of(self, healthy: Number, t_s: float) -> Number:
        """Apply the impulse; the value is healthy between impulses."""
        # CLOSE_S: a frame at the end of an impulse is healthy.
        if time_since_period(t_s, self.period_s) >= self.width_s - CLOSE_S:
            return healthy
        return combine_values(self.mode, healthy, self.value)


class Cycle(ValueFault, frozen=True, kw_only=True):
    """Add `value` to one element (or satellite) after another, each for `period_s`."""

    name: ClassVar[str] = "cycle"
    example: ClassVar[dict[str, Any]] = {
        "target": ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro", "HIL_SENSOR.zgyro"],
        "value": 1.0,
        "period_s": 0.1,
    }
    on_ranges: ClassVar[bool] = True

    value: float
    period_s: Duration

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Add the error to the element of the current period."""
        # By time, so that lost frames do not shift the cycle.
        active = int((t_s + CLOSE_S) / self.period_s) % len(before)
        return [x + self.value * (i == active) for i, x in enumerate(before)], None
