"""What a fault is: one frame in, timed frames out.

`Entry` (in `schedule`) says when, which frames and how often; a `Fault` says what happens to them.
A fault is a frozen set of parameters; its moving part is the state it hands back. It does no I/O,
takes time as `t_us` and chance from `rng`, and never changes its arguments.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mavproxy_fault.wire.frame import Frame


@dataclass(frozen=True, slots=True)
class Outgoing:
    """Bytes to send no earlier than `due_us`; raw bytes where a fault broke the frame."""

    due_us: int
    frame: Frame | bytes


class Fault(Protocol):
    """The contract; `state` is whatever `new_state` returned."""

    def new_state(self) -> Any:
        """The state before the first frame."""

    def apply(
        self, frame: Frame, t_us: int, state: Any, rng: np.random.Generator
    ) -> tuple[list[Outgoing], Any]:
        """What leaves for one frame that came at `t_us`, and the next state.

        An untouched frame leaves as the same object at `t_us`. Nothing is due before `t_us`.
        """
