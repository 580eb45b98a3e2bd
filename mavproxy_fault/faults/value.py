"""Value faults: they change elements of a frame in place and say how much and whether it fitted."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import msgspec
import numpy as np

from mavproxy_fault.faults.base import ActsOn, Outgoing
from mavproxy_fault.faults.target import Element
from mavproxy_fault.wire.dialect import Field
from mavproxy_fault.wire.frame import FLOAT_MAX, Frame, Number, saturate


class Moving(NamedTuple):
    """The state of every value fault: when it began, and what the fault itself remembers."""

    start_us: int
    memory: Any


class ValueFault(msgspec.Struct, frozen=True, kw_only=True):
    """A fault on some elements of some messages.

    A concrete fault has `after`, which turns healthy values into faulty ones.
    """

    acts_on: ClassVar[ActsOn] = "fields"
    elements: Mapping[int, tuple[Element, ...]] = {}

    def new_state(self, start_us: int) -> Moving:
        """The state when the fault becomes active."""
        return Moving(start_us, None)

    def apply(
        self, frame: Frame, t_us: int, state: Moving, rng: np.random.Generator
    ) -> tuple[list[Outgoing], Moving]:
        """Change the elements of one frame."""
        places = self.elements[frame.id]
        before = [frame.number(name, index) for name, index in places]
        t_s = (t_us - state.start_us) * 1e-6
        after, memory = self.after(before, source(frame), t_s, state.memory, rng)
        return [changed(frame, t_us, places, after)], Moving(state.start_us, memory)

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, memory: Any, rng: Any
    ) -> tuple[Sequence[Number], Any]:
        """The faulty values of one frame and what to remember.

        Parameters
        ----------
        before : list of number
            Healthy values of the elements, in the order of the target.
        key : tuple of int
            Who sent the frame (system, component, message id, instance).
        t_s : float
            Seconds since the fault became active.
        memory
            What the last call returned; None at first.
        rng : numpy.random.Generator
            The entry's own stream.
        """
        raise NotImplementedError


def source(frame: Frame) -> tuple[int, ...]:
    """Who sent a frame: system, component, message id and instance."""
    name = frame.layout.instance or ("id" if "id" in frame.layout.fields else "")
    value = frame.read(name) if name else 0
    return (frame.system, frame.component, frame.id, value if isinstance(value, int) else 0)


def changed(
    frame: Frame, t_us: int, places: Sequence[Element], values: Sequence[Number]
) -> Outgoing:
    """The frame with other values at some places; the same object if no byte differs."""
    changes = dict(zip(places, values, strict=True))
    patched = frame.patched(changes)
    if patched.raw == frame.raw:
        return Outgoing(t_us, frame)
    size: float | None = None
    saturated = 0
    fields = frame.layout.fields
    for (name, index), value in changes.items():
        saturated += not fits(fields[name], value)
        step = abs(patched.number(name, index) - frame.number(name, index))
        if math.isfinite(step):
            size = step if size is None else max(size, step)
    return Outgoing(t_us, patched, size, saturated)


def fits(field: Field, value: Number) -> bool:
    """Whether a field can hold a value, but for rounding."""
    if field.code == "d":
        return True
    if field.code == "f":
        return abs(value) <= FLOAT_MAX or not math.isfinite(value)
    return math.isfinite(value) and saturate(field, value) == round(value)


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
