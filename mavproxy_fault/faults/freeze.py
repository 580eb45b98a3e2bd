"""Values that stand still."""

from typing import Any

from mavproxy_fault.faults.value import ValueFault
from mavproxy_fault.wire.frame import Number


class Freeze(ValueFault, frozen=True, kw_only=True):
    """Hold the values of the first frame after the fault began (a stuck sensor)."""

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, memory: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """The values of this sender's first frame."""
        held: dict[tuple[int, ...], list[Number]] = memory or {}
        if key in held:
            return held[key], held
        return before, {**held, key: before}
