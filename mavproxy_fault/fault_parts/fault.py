"""The contract of a fault: one frame in, timed frames out.

`Entry` (in `schedule`) defines when, on which frames and how often; a `Fault` defines the effect.
A fault is a frozen set of parameters (a `msgspec.Struct`, which also defines the keys of a schedule
and its JSON Schema); its state is passed in and returned. It does no I/O, takes time as `t_us` and
randomness from `rng`, and never changes its arguments.
"""

from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

import msgspec

from mavproxy_fault.wire.frame import Frame

if TYPE_CHECKING:
    from numpy.random import Generator as Generator
else:
    Generator = Any  # numpy takes a third of a proxy's start-up time

ActsOn = Literal["fields", "frames", "satellites", "plant"]


class Outgoing(msgspec.Struct, frozen=True):
    """A frame to send no earlier than `due_us`; raw bytes if a fault made it invalid.

    `magnitude` is the largest change in this frame in the field's unit (metres for positions and
    satellites, seconds for delays), `saturated` the number of values out of their field's range.
    With `back` the frame is sent to the link of the frame that it replies to. `links` are those
    that it may go to, a bit mask.
    """

    due_us: int
    frame: Frame | bytes
    magnitude: float | None = None
    saturated: int = 0
    back: bool = False
    links: int = -1


class Fault(Protocol):
    """The contract; `state` is the value that `new_state` or the last `apply` returned.

    A value fault (`value_fault.ValueFault`) only needs the rule `after`.

    `acts_on` defines what `target` names: fields of messages (passed as `elements`), complete
    frames, satellites or plant parameters (passed as `names`).

    A fault of a schedule also has a `name`, by which the registry finds it, and an `example`: the
    keys beside `fault: NAME` in the entry that `faults show` prints and the tests run. It may have
    `aliases` (further names) and `on_ranges`, true if its error does not depend on the healthy
    value, so that it accepts PSEUDORANGE targets too. `clock` is "link" if its times count in link
    time by default. A fault with a method `done(state)` ends
    as soon as that returns true, before its `for_s`. `release(t_us, state)` returns what is to be
    sent at its end, and the next state; one that buffers frames until others have arrived returns
    all of them, and also has `release_us(state)`, the due time of the oldest (None without one).
    """

    acts_on: ClassVar[ActsOn]

    def new_state(self, start_us: int) -> Any:
        """Return the initial state; the fault is active from `start_us` on."""

    def apply(
        self, frame: Frame, t_us: int, state: Any, rng: Generator
    ) -> tuple[list[Outgoing], Any]:
        """Return the frames to send for one received at `t_us`, and the next state.

        An unchanged frame is returned as the same object, due at `t_us`. Nothing is due earlier.
        """


class LinkFault(msgspec.Struct, frozen=True, kw_only=True):
    """A fault of the link: it also acts on bytes that are not a frame, and on signed frames.

    `takes_unknown` (by default `takes_bytes`) means frames of unknown messages, whose layout has no
    fields.
    """

    acts_on: ClassVar[ActsOn] = "frames"
    clock: ClassVar[Literal["vehicle", "link"]] = "link"
    takes_bytes: ClassVar[bool] = True
    takes_sealed: ClassVar[bool] = True

    def new_state(self, start_us: int) -> Any:
        """Return None, for faults without a state."""
