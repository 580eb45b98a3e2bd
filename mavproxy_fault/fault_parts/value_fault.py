"""Value faults: rules that turn the healthy values of some elements into faulty ones.

The rule knows numbers alone. `proxy/value_entry.py` carries it out on a frame, together with the
others that act there, and counts what it changed.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import msgspec

from mavproxy_fault.fault_parts.elements import Element
from mavproxy_fault.fault_parts.fault import ActsOn
from mavproxy_fault.fault_parts.units import Factors
from mavproxy_fault.wire.frame import Number

GYRO = "HIL_SENSOR.xgyro"  # what the faults' examples act on
MOST_SENDERS = 256  # whose states a fault keeps; those who come later pass it by
MOST_ROWS = 65_536  # values of the past that a fault keeps per sender; 65 s at 1 kHz
GYROS = ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro", "HIL_SENSOR.zgyro"]


class ValueState(NamedTuple):
    """The state of every value fault: when it began, and the state of the fault's own rule."""

    start_us: int
    inner: Any


class ValueFault(msgspec.Struct, frozen=True, kw_only=True):
    """A fault on some elements of some messages.

    A concrete fault has `of`, which turns one healthy value into a faulty one, or `after`, which
    does so with all values of a frame and may keep a state; with `by_sender` it is told who sent
    them. Values are in the unit of the first target of their quantity (`factors`).
    """

    acts_on: ClassVar[ActsOn] = "fields"
    by_sender: ClassVar[bool] = False
    on_wire: ClassVar[bool] = False  # whether it acts on the numbers as sent, in whatever unit
    draws: ClassVar[bool] = False  # whether `after` uses its generator
    elements: Mapping[int, tuple[Element, ...]] = {}
    factors: Factors = {}

    def __post_init__(self) -> None:
        value = getattr(self, "value", None)
        # One number or a list of one for each element, in every message of the target.
        if isinstance(value, tuple):
            for elements in self.elements.values():
                broadcast_values(value, len(elements))

    def new_state(self, start_us: int) -> ValueState:
        """The state when the fault becomes active."""
        return ValueState(start_us, None)

    @property
    def by_value(self) -> bool:
        """Whether `of` says all: each value by itself, without a state."""
        # A class that has its own `after` means that, whatever it derives from.
        rules = (vars(kind) for kind in type(self).__mro__ if kind is not ValueFault)
        return next(("of" in rule for rule in rules if "of" in rule or "after" in rule), False)

    def of(self, healthy: Number, t_s: float) -> Number:
        """The faulty value of one element, so many seconds after the fault became active."""
        raise NotImplementedError

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[Sequence[Number], Any]:
        """The faulty values of one frame and the next state of the rule.

        Parameters
        ----------
        before : list of number
            Healthy values of the elements, in the order of the target.
        key : tuple of int
            Who sent the frame (system, component, message id, instance), or empty.
        t_s : float
            Seconds since the fault became active.
        state
            What the last call returned; None at first.
        rng : numpy.random.Generator
            The entry's own stream.
        """
        return [self.of(x, t_s) for x in before], None


def can_add_sender(inner: Any, key: tuple[int, ...]) -> bool:
    """Whether a rule's state may take up a sender: a peer can make up any number of them."""
    return not isinstance(inner, dict) or len(inner) < MOST_SENDERS or key in inner


def broadcast_values(value: float | tuple[float, ...], count: int) -> Sequence[float]:
    """One number for every element: the same for all, or a list of as many.

    Raises
    ------
    ValueError
        If a list has another length.
    """
    if isinstance(value, tuple):
        if len(value) != count:
            raise ValueError(f"has {len(value)} numbers for {count} elements; give one or {count}")
        return value
    return (value,) * count
