"""Faults of vector sensors: swapped axes, rotation (misalignment), hard and soft iron."""

import math
from collections.abc import Sequence
from typing import Any, ClassVar

from mavproxy_fault.fault_parts.value_fault import ValueFault
from mavproxy_fault.numerics.rotations.one_rotation import Matrix, body_matrix
from mavproxy_fault.wire.frame import Number

Three = tuple[float, float, float]


class AxisSwap(ValueFault, frozen=True, kw_only=True):
    """Permute the elements (default: in reverse order); `signs` may invert them."""

    name: ClassVar[str] = "axis-swap"
    example: ClassVar[dict[str, Any]] = {
        "target": ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro", "HIL_SENSOR.zgyro"]
    }

    order: tuple[int, ...] | None = None
    signs: tuple[float, ...] | None = None

    # Checked when the schedule is read, so that no frame fails later.
    def __post_init__(self) -> None:
        for listed in self.elements.values():
            indices = list(range(len(listed)))
            if len(listed) < 2:
                raise ValueError("needs two fields or more; add fields to target")
            if self.order is not None and sorted(self.order) != indices:
                raise ValueError(f"order = {list(self.order)} must contain each of {indices} once")
            if self.signs is not None and len(self.signs) != len(listed):
                raise ValueError(f"signs must be {len(listed)} numbers")

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Element i takes the value of element order[i]."""
        # Reversed by default, which swaps two elements.
        order = self.order or tuple(reversed(range(len(before))))
        signs = self.signs or (1,) * len(before)
        return [sign * before[i] for i, sign in zip(order, signs, strict=True)], None


class Rotation(ValueFault, frozen=True, kw_only=True):
    """Rotate three elements as one vector by roll, pitch and yaw (a misaligned sensor)."""

    name: ClassVar[str] = "rotation"
    example: ClassVar[dict[str, Any]] = {
        "target": ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro", "HIL_SENSOR.zgyro"],
        "angles_deg": [0, 0, 90],
    }

    angles_deg: Three

    def __post_init__(self) -> None:
        check_vector_target(self.elements)

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Return the vector as measured by a sensor rotated by these angles."""
        roll, pitch, yaw = (math.radians(angle) for angle in self.angles_deg)
        return multiply_matrix(body_matrix(roll, pitch, yaw), before), None


class Iron(ValueFault, frozen=True, kw_only=True):
    """Multiply the field by soft iron (a 3 x 3 matrix) and add hard iron (an offset)."""

    name: ClassVar[str] = "iron"
    example: ClassVar[dict[str, Any]] = {
        "target": ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro", "HIL_SENSOR.zgyro"],
        "hard": [0.1, 0, 0],
    }

    hard: Three = (0.0, 0.0, 0.0)
    soft: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def __post_init__(self) -> None:
        check_vector_target(self.elements)

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """soft @ field + hard."""
        field = multiply_matrix(self.soft, before)
        return [x + offset for x, offset in zip(field, self.hard, strict=True)], None


def check_vector_target(elements: Any) -> None:
    """Refuse a target that is not a vector.

    Raises
    ------
    ValueError
        If a message does not have exactly three elements.
    """
    for listed in elements.values():
        if len(listed) != 3:
            raise ValueError(f"acts on three fields, not {len(listed)}; give x, y and z in target")


def multiply_matrix(matrix: Matrix, vector: Sequence[float]) -> list[float]:
    """matrix @ vector."""
    return [sum(a * b for a, b in zip(row, vector, strict=True)) for row in matrix]
