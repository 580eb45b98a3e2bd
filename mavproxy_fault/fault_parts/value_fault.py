"""Value faults: rules that turn healthy values of elements into faulty ones.

A rule sees numbers only.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import msgspec

from mavproxy_fault.fault_parts.elements import (
    Element,
    read_elements,
    sender_of,
    write_elements,
)
from mavproxy_fault.fault_parts.fault import ActsOn, Outgoing
from mavproxy_fault.fault_parts.units import Factors
from mavproxy_fault.wire.frame import Frame, Number

GYRO = "HIL_SENSOR.xgyro"  # targets of the faults' examples
GYROS = ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro", "HIL_SENSOR.zgyro"]
MOST_SENDERS = 256  # chosen: bounds the memory against made-up senders; later ones are not faulted
MOST_ROWS = 65_536  # stored past values per sender: 65 s at 1 kHz


class ValueState(NamedTuple):
    """The state of every value fault: its start time and the state of its rule."""

    start_us: int
    inner: Any


class ValueFault(msgspec.Struct, frozen=True, kw_only=True):
    """A fault on elements of messages.

    A concrete fault defines `of`, which turns one healthy value into a faulty one, or `after`,
    which does so for all values of a frame and may have a state; with `by_sender` it also gets
    their sender. Values are in the unit of the first target of their quantity (`factors`).
    """

    acts_on: ClassVar[ActsOn] = "fields"
    by_sender: ClassVar[bool] = False
    on_wire: ClassVar[bool] = False  # whether it acts on the numbers as sent, in any unit
    draws: ClassVar[bool] = False  # whether `after` uses its generator
    elements: Mapping[int, tuple[Element, ...]] = {}
    factors: Factors = {}

    def __post_init__(self) -> None:
        value = getattr(self, "value", None)
        # A list must have one number for each element of every message.
        if isinstance(value, tuple):
            for elements in self.elements.values():
                broadcast_values(value, len(elements))

    def new_state(self, start_us: int) -> ValueState:
        """Return the state when the fault becomes active."""
        return ValueState(start_us, None)

    def apply(
        self, frame: Frame, t_us: int, state: ValueState, rng: Any
    ) -> tuple[list[Outgoing], ValueState]:
        """Apply the rule to the values of a frame, in the units of the first target."""
        elements, (start_us, inner) = self.elements[frame.id], state
        key = sender_of(frame) if self.by_sender else ()
        if key and not can_add_sender(inner, key):
            return [Outgoing(t_us, frame)], state
        before, factors = read_elements(frame, elements), self.factors.get(frame.id)
        if factors is not None:
            before = [x / f for x, f in zip(before, factors, strict=True)]
        after, inner = self.after(before, key, (t_us - start_us) / 1e6, inner, rng)
        if factors is not None:
            after = [y * f for y, f in zip(after, factors, strict=True)]
        return [write_elements(frame, t_us, elements, after)], ValueState(start_us, inner)

    def of(self, healthy: Number, t_s: float) -> Number:
        """Return the faulty value of one element, `t_s` seconds after the start of the fault."""
        raise NotImplementedError

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[Sequence[Number], Any]:
        """Return the faulty values of one frame and the next state of the rule.

        Parameters
        ----------
        before : list of number
            Healthy values of the elements, in the order of the target.
        key : tuple of int
            Sender of the frame (system, component, message id, instance), or empty.
        t_s : float
            Seconds since the start of the fault.
        state
            The state returned by the last call; None at first.
        rng : numpy.random.Generator
            The entry's random stream.
        """
        return [self.of(x, t_s) for x in before], None


def can_add_sender(inner: Any, key: tuple[int, ...]) -> bool:
    """Whether a rule's state may store a sender; bounded, since a peer can make up any number."""
    return not isinstance(inner, dict) or len(inner) < MOST_SENDERS or key in inner


def broadcast_values(value: float | tuple[float, ...], count: int) -> Sequence[float]:
    """Return one number for every element: the same for all, or those of a list.

    Raises
    ------
    ValueError
        If a list has another length.
    """
    if isinstance(value, tuple):
        if len(value) != count:
            raise ValueError(f"has {len(value)} numbers for {count} elements; give 1 or {count}")
        return value
    return (value,) * count
