"""White noise and random walk."""

import math
from typing import Any, ClassVar, Literal

from mavproxy_fault.fault_parts.profile import NotNegative
from mavproxy_fault.fault_parts.value_fault import GYRO, ValueFault, broadcast_values
from mavproxy_fault.wire.frame import Number


class NoiseFault(ValueFault, frozen=True, kw_only=True):
    """Add white noise: Gaussian with sigma `value`, or uniform within plus or minus `value`."""

    name: ClassVar[str] = "noise"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    draws: ClassVar[bool] = True
    on_ranges: ClassVar[bool] = True

    value: NotNegative | tuple[NotNegative, ...]
    distribution: Literal["gaussian", "uniform"] = "gaussian"

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Add one draw to each element."""
        count = len(before)
        sigma = broadcast_values(self.value, count)
        if self.distribution == "uniform":
            draws = rng.uniform(-1.0, 1.0, count).tolist()
        else:
            # A single draw gives the same number faster without an array.
            draws = rng.standard_normal(count).tolist() if count > 1 else (rng.standard_normal(),)
        return [x + draws[n] * sigma[n] for n, x in enumerate(before)], None


class RandomWalk(ValueFault, frozen=True, kw_only=True):
    """Add a Wiener process: its sigma is `value` times the square root of the elapsed seconds."""

    name: ClassVar[str] = "random-walk"
    example: ClassVar[dict[str, Any]] = {"target": GYRO, "value": 0.1}
    draws: ClassVar[bool] = True
    on_ranges: ClassVar[bool] = True
    by_sender: ClassVar[bool] = True

    value: NotNegative

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Take a random step for the time since this sender's last frame."""
        walks: dict[tuple[int, ...], tuple[float, tuple[float, ...]]] = state or {}
        last_s, walked = walks.get(key, (0.0, (0.0,) * len(before)))
        # Variance grows with time, not with frames, so lost frames do not slow the walk.
        sigma = self.value * math.sqrt(max(t_s - last_s, 0.0))
        steps = rng.normal(0.0, 1.0, len(before)) * sigma
        walk = tuple(w + float(step) for w, step in zip(walked, steps, strict=True))
        after = [x + error for x, error in zip(before, walk, strict=True)]
        return after, {**walks, key: (t_s, walk)}
