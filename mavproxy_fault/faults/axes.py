"""Faults of three axes together: swapped, turned (misalignment), hard and soft iron."""

import math
from typing import Any

import numpy as np

from mavproxy_fault.faults.value import ValueFault
from mavproxy_fault.wire.frame import Number

Three = tuple[float, float, float]


class AxisSwap(ValueFault, frozen=True, kw_only=True):
    """Put the elements in another order (the last first by default); `signs` may turn them."""

    order: tuple[int, ...] | None = None
    signs: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for places in self.elements.values():
            wanted = list(range(len(places)))
            if len(places) < 2:
                raise ValueError("swaps nothing; give two fields or more as target")
            if self.order is not None and sorted(self.order) != wanted:
                raise ValueError(f"order = {list(self.order)} must hold each of {wanted} once")
            if self.signs is not None and len(self.signs) != len(places):
                raise ValueError(f"signs must be {len(places)} numbers")

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, memory: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Element i takes the value of element order[i]."""
        order = self.order or tuple(reversed(range(len(before))))
        signs = self.signs or (1,) * len(before)
        return [sign * before[i] for i, sign in zip(order, signs, strict=True)], None


class Rotation(ValueFault, frozen=True, kw_only=True):
    """Turn three elements as one vector by roll, pitch and yaw (a misaligned sensor)."""

    angles_deg: Three

    def __post_init__(self) -> None:
        check_three(self.elements)

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, memory: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """The vector as a sensor turned by these angles measures it."""
        return [float(x) for x in turn(self.angles_deg) @ np.array(before, float)], None


class Iron(ValueFault, frozen=True, kw_only=True):
    """Magnetic surroundings: soft iron (a 3 x 3 matrix) times the field plus hard iron (offset)."""

    hard: Three = (0.0, 0.0, 0.0)
    soft: tuple[Three, Three, Three] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def __post_init__(self) -> None:
        check_three(self.elements)

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, memory: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """soft @ field + hard."""
        field = np.array(self.soft) @ np.array(before, float) + np.array(self.hard)
        return [float(x) for x in field], None


def check_three(elements: Any) -> None:
    """Refuse a target that is no vector.

    Raises
    ------
    ValueError
        If a message has not exactly three elements.
    """
    for places in elements.values():
        if len(places) != 3:
            raise ValueError(f"acts on three fields, not {len(places)}; give x, y and z as target")


def turn(angles_deg: Three) -> np.ndarray:
    """The matrix (3, 3) from body axes to axes turned by yaw, then pitch, then roll."""
    roll, pitch, yaw = (math.radians(angle) for angle in angles_deg)
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    about_x = np.array([[1, 0, 0], [0, cr, sr], [0, -sr, cr]])
    about_y = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    about_z = np.array([[cy, sy, 0], [-sy, cy, 0], [0, 0, 1]])
    turned: np.ndarray = about_x @ about_y @ about_z
    return turned
