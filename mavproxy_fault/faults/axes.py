"""Faults of vector sensors: swapped axes, rotation (misalignment), hard and soft iron."""

import math
from typing import Any, ClassVar

from mavproxy_fault.fault_parts.rules import Numbers, RuleFault, value_rule
from mavproxy_fault.fault_parts.value_fault import GYROS
from mavproxy_fault.numerics.rotations.one_rotation import Matrix, body_matrix

Three = tuple[float, float, float]


@value_rule
def take_other(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Take the value of the element `p[0]` with the sign `p[1]`."""
    return p[1] * x[int(p[0])]


class AxisSwap(RuleFault, frozen=True, kw_only=True):
    """Permute the elements (default: in reverse order); `signs` may invert them."""

    name: ClassVar[str] = "axis-swap"
    example: ClassVar[dict[str, Any]] = {"target": GYROS}
    rule = staticmethod(take_other)

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

    def numbers(self, count: int) -> list[Numbers]:
        """Element i takes the value of element order[i]."""
        # Reversed by default, which swaps two elements.
        order = self.order or tuple(reversed(range(count)))
        return list(zip(map(float, order), self.signs or (1.0,) * count, strict=True))


@value_rule
def multiply_row(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """A row of a matrix times the vector, plus an offset."""
    return p[0] * x[0] + p[1] * x[1] + p[2] * x[2] + p[3]


class VectorFault(RuleFault, frozen=True, kw_only=True):
    """Base of faults that multiply three elements, as one vector, by a matrix."""

    rule = staticmethod(multiply_row)

    def __post_init__(self) -> None:
        for listed in self.elements.values():
            if len(listed) != 3:
                raise ValueError(
                    f"acts on three fields, not {len(listed)}; give x, y and z in target"
                )


class Rotation(VectorFault, frozen=True, kw_only=True):
    """Rotate three elements as one vector by roll, pitch and yaw (a misaligned sensor)."""

    name: ClassVar[str] = "rotation"
    example: ClassVar[dict[str, Any]] = {"target": GYROS, "angles_deg": [0, 0, 90]}

    angles_deg: Three

    def numbers(self, count: int) -> list[Numbers]:
        """Return the rows of the matrix that a rotated sensor multiplies by."""
        roll, pitch, yaw = (math.radians(angle) for angle in self.angles_deg)
        return [(*row, 0.0) for row in body_matrix(roll, pitch, yaw)]


class Iron(VectorFault, frozen=True, kw_only=True):
    """Multiply the field by soft iron (a 3 x 3 matrix) and add hard iron (an offset)."""

    name: ClassVar[str] = "iron"
    example: ClassVar[dict[str, Any]] = {"target": GYROS, "hard": [0.1, 0, 0]}

    hard: Three = (0.0, 0.0, 0.0)
    soft: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    def numbers(self, count: int) -> list[Numbers]:
        """Return the rows of soft iron, each with its offset."""
        return [(*row, offset) for row, offset in zip(self.soft, self.hard, strict=True)]
