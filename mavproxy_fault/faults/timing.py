"""Late frames."""

from typing import Any

import numpy as np

from mavproxy_fault.faults.base import LinkFault, Outgoing
from mavproxy_fault.faults.profile import NotNegative
from mavproxy_fault.wire.frame import Frame


class Delay(LinkFault, frozen=True, kw_only=True):
    """Hold every frame back by `value` seconds."""

    value: NotNegative

    def new_state(self, start_us: int) -> None:
        """Nothing to remember."""

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: np.random.Generator
    ) -> tuple[list[Outgoing], Any]:
        """The same frame, later."""
        return [late(frame, t_us, self.value)], None


def late(frame: Frame | bytes, t_us: int, by_s: float) -> Outgoing:
    """A frame held back by so many seconds."""
    by_us = round(by_s * 1e6)
    return Outgoing(t_us + by_us, frame, by_us * 1e-6 if by_us else None)
