"""Value faults: they change elements of a frame in place and say how much and whether it fitted."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import msgspec

from mavproxy_fault.faults.elements import Element, changed, places_of, values_at
from mavproxy_fault.faults.fault import ActsOn, Outgoing
from mavproxy_fault.faults.units import Factors
from mavproxy_fault.wire.frame import Frame, Number

if TYPE_CHECKING:
    from numpy.random import Generator


GYRO = "HIL_SENSOR.xgyro"  # what the faults' examples act on
GYROS = ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro", "HIL_SENSOR.zgyro"]


class ValueState(NamedTuple):
    """The state of every value fault: when it began, and the state of the fault's own rule."""

    start_us: int
    inner: Any


class ValueFault(msgspec.Struct, frozen=True, kw_only=True):
    """A fault on some elements of some messages.

    A concrete fault has `after`, which turns healthy values into faulty ones, in the unit of the
    first target of their quantity (`factors`); with `by_sender` it is told who sent them.
    """

    acts_on: ClassVar[ActsOn] = "fields"
    by_sender: ClassVar[bool] = False
    draws: ClassVar[bool] = False  # whether `after` uses its generator
    elements: Mapping[int, tuple[Element, ...]] = {}
    factors: Factors = {}

    def __post_init__(self) -> None:
        value = getattr(self, "value", None)
        # One number or a list of one for each element, in every message of the target.
        if isinstance(value, tuple):
            for places in self.elements.values():
                each(value, len(places))

    def new_state(self, start_us: int) -> ValueState:
        """The state when the fault becomes active."""
        return ValueState(start_us, None)

    def apply(
        self, frame: Frame, t_us: int, state: ValueState, rng: "Generator"
    ) -> tuple[list[Outgoing], ValueState]:
        """Change the elements of one frame."""
        places = places_of(frame.id, self.elements[frame.id])
        before = values_at(frame, places)
        factors = self.factors.get(frame.id)
        # Targets may have other units (mG, cm/s); the fault thinks in that of the first.
        seen = before if factors is None else [x / f for x, f in zip(before, factors, strict=True)]
        key = sender(frame) if self.by_sender else ()
        after, inner = self.after(seen, key, (t_us - state.start_us) / 1e6, state.inner, rng)
        # Most faults keep nothing: no new tuple for each frame.
        if inner is not state.inner:
            state = ValueState(state.start_us, inner)
        if factors is not None:
            after = [y * f for y, f in zip(after, factors, strict=True)]
        return [changed(frame, t_us, places, before, after)], state

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
        raise NotImplementedError


def sender(frame: Frame) -> tuple[int, ...]:
    """Who sent a frame: system, component, message id and instance."""
    # Two sensors of one vehicle send the same message; the instance tells them apart.
    name = frame.layout.instance or ("id" if "id" in frame.layout.fields else "")
    value = frame.read(name) if name else 0
    return (frame.system, frame.component, frame.id, value if isinstance(value, int) else 0)


def each(value: float | tuple[float, ...], count: int) -> Sequence[float]:
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
