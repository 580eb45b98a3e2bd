"""Lost frames: at random, in bursts, or all of them."""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from mavproxy_fault.faults.base import LinkFault, Outgoing
from mavproxy_fault.wire.frame import Frame

Share = Annotated[float, Meta(ge=0, le=1)]


class Drop(LinkFault, frozen=True, kw_only=True):
    """Lose frames at random; `value` is the share that is lost, all by default."""

    value: Share = 1.0

    def new_state(self, start_us: int) -> None:
        """Nothing to remember."""

    def apply(
        self, frame: Frame | bytes, t_us: int, state: Any, rng: np.random.Generator
    ) -> tuple[list[Outgoing], Any]:
        """Lose this frame or not."""
        if self.value < 1.0 and rng.random() >= self.value:
            return [Outgoing(t_us, frame)], None
        return [], None
