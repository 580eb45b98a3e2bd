"""What a fault is: one frame in, timed frames out.

`Entry` (in `schedule`) says when, which frames and how often; a `Fault` says what happens to them.
A fault is a frozen set of parameters (a `msgspec.Struct`, so that a schedule and its JSON Schema
come from the same lines); its moving part is the state it hands back. It does no I/O, takes time
as `t_us` and chance from `rng`, and never changes its arguments.
"""

from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, runtime_checkable

import msgspec

from mavproxy_fault.wire.frame import Frame

if TYPE_CHECKING:
    from numpy.random import Generator

ActsOn = Literal["fields", "frames", "satellites", "plant"]


class Outgoing(msgspec.Struct, frozen=True):
    """Bytes to send no earlier than `due_us`; raw bytes where a fault broke the frame.

    `magnitude` is the largest change in this frame in the field's unit (metres for positions and
    satellites, seconds for delays), `saturated` the number of values that did not fit their field.
    With `back` the frame goes to where the one that called it forth came from.
    """

    due_us: int
    frame: Frame | bytes
    magnitude: float | None = None
    saturated: int = 0
    back: bool = False


class Fault(Protocol):
    """The contract; `state` is whatever `new_state` returned.

    A value fault (`value_fault.ValueFault`) has the rule `after` in the place of `apply`.

    `acts_on` says what `target` names: fields of messages (handed over as `elements`), whole
    frames, satellites or plant parameters (handed over as `names`).

    A fault of a schedule also has a `name`, which the registry finds it by, and an `example`: what
    stands beside `fault: NAME` in the entry that `faults show` prints and the tests run. It may
    have `aliases`, further names, and `on_ranges`, true if its error does not depend on the healthy
    value, so that it acts on PSEUDORANGE targets too. One with `done(state)` ends as soon as that
    is true, before its `for_s`.
    """

    acts_on: ClassVar[ActsOn]

    def new_state(self, start_us: int) -> Any:
        """The state before the first frame; the fault is active from `start_us` on."""

    def apply(
        self, frame: Frame, t_us: int, state: Any, rng: "Generator"
    ) -> tuple[list[Outgoing], Any]:
        """What leaves for one frame that came at `t_us`, and the next state.

        An untouched frame leaves as the same object at `t_us`. Nothing is due before `t_us`.
        """


class LinkFault(msgspec.Struct, frozen=True, kw_only=True):
    """A fault of the link: it takes bytes that are no frame as well, and signed frames."""

    acts_on: ClassVar[ActsOn] = "frames"
    takes_bytes: ClassVar[bool] = True
    takes_sealed: ClassVar[bool] = True

    def new_state(self, start_us: int) -> Any:
        """Nothing to remember, for the faults that treat each frame by itself."""


@runtime_checkable
class Buffering(Protocol):
    """A fault that keeps frames back until others have come."""

    def release_us(self, state: Any) -> int | None:
        """When the oldest frame kept must leave; None if none is kept."""

    def release(self, t_us: int, state: Any) -> tuple[list[Outgoing], Any]:
        """Everything kept, to be sent now, and the state without it."""
