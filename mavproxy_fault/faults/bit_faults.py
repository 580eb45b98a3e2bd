"""Faults of the binary representation: flipped bits, not-a-number, cleared flags."""

from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta

from mavproxy_fault.fault_parts.profile import MODES
from mavproxy_fault.fault_parts.rules import (
    Drawn,
    Numbers,
    RuleFault,
    choose_place,
    value_rule,
)
from mavproxy_fault.fault_parts.value_fault import GYRO, ValueFault
from mavproxy_fault.faults.profile_faults import combine_number
from mavproxy_fault.wire.dialect import PACKERS, message_layout
from mavproxy_fault.wire.frame import Number

# HIL_SENSOR.fields_updated (HIL_SENSOR_UPDATED_FLAGS); PX4 takes baro only with bits 9, 11 and 12.
GROUPS = {
    "accel": 0x7,
    "gyro": 0x38,
    "mag": 0x1C0,
    "baro": 0x1A00,
    "airspeed": 0x400,
}
Group = Literal["accel", "gyro", "mag", "baro", "airspeed"]


def count_flips(bits: int, p: Numbers) -> int:
    """Return how many of an element's bits are drawn; a rule."""
    return 0 if p[1] >= 0 else min(int(p[0]), bits)


def flip_bits(data: Any, at: int, bits: int, p: Numbers, draws: Any) -> None:
    """Flip drawn bits of an element as encoded on the wire, or bit `p[1]`; a rule."""
    count = count_flips(bits, p)
    for n in range(max(count, 1)):
        # The bit number wraps in narrower fields.
        place = choose_place(n, count, bits, draws) if count else int(p[1]) % bits
        data[at + place // 8] ^= 1 << place % 8


class BitFlip(ValueFault, frozen=True, kw_only=True):
    """Flip bits of the elements as encoded on the wire: `value` random ones, or `bit`."""

    name: ClassVar[str] = "bit-flip"
    example: ClassVar[dict[str, Any]] = {"target": GYRO}
    effect: ClassVar[str] = "flip"
    on_wire: ClassVar[bool] = True
    by_sender: ClassVar[bool] = True  # the message id gives the types of the elements

    value: Annotated[int, Meta(ge=1, le=64)] = 1
    bit: Annotated[int, Meta(ge=0, le=63)] | None = None

    @property
    def drawn(self) -> Drawn:
        """Nothing for a given bit."""
        return "random" if self.bit is None else ""

    def numbers(self, count: int) -> list[Numbers]:
        """Return how many bits are flipped, and which one, -1 if they are drawn."""
        return [(float(self.value), -1.0 if self.bit is None else float(self.bit))] * count

    def after(
        self, before: list[Number], key: tuple[int, ...], t_s: float, state: Any, rng: Any
    ) -> tuple[list[Number], Any]:
        """Flip bits in each element of one frame."""
        found, p = [], self.numbers(1)[0]
        for x, element in zip(before, self.elements[key[2]], strict=True):
            packer = PACKERS[element.code]
            data = bytearray(packer.pack(x))
            count = count_flips(8 * len(data), p)
            flip_bits(data, 0, 8 * len(data), p, rng.random(count).tolist() if count else [])
            found.append(packer.unpack(data)[0])
        return found, None


class NotANumber(RuleFault, frozen=True, kw_only=True):
    """Send NaN, or plus or minus infinity, in floating-point fields."""

    name: ClassVar[str] = "not-a-number"
    example: ClassVar[dict[str, Any]] = {"target": GYRO}
    aliases: ClassVar[tuple[str, ...]] = ("nan",)
    rule = staticmethod(combine_number)

    value: Literal["nan", "inf", "-inf"] = "nan"

    def __post_init__(self) -> None:
        # An integer field would become zero instead.
        for number, elements in self.elements.items():
            for one in elements:
                if one.code not in "fd":
                    raise ValueError(
                        f"{message_layout(number).name}.{one.name} is an integer, "
                        f"which cannot be {self.value}; give a float"
                    )

    def numbers(self, count: int) -> list[Numbers]:
        """Return the same value for all elements."""
        return [(MODES["replace"], float(self.value))] * count


@value_rule
def clear_bits(x: Any, i: int, t_s: float, p: Numbers, m: Any, u: float) -> Any:
    """Return the flags without those bits; both fit 52 bits."""
    return int(x[i]) & ~int(p[0])


class ClearBits(RuleFault, frozen=True, kw_only=True):
    """Clear flags: the bits of `value`, or those of sensor groups in HIL_SENSOR.fields_updated."""

    name: ClassVar[str] = "clear-bits"
    example: ClassVar[dict[str, Any]] = {"target": "HIL_SENSOR.fields_updated", "groups": ["baro"]}
    rule = staticmethod(clear_bits)

    value: Annotated[int, Meta(ge=0)] = 0
    groups: tuple[Group, ...] = ()

    def __post_init__(self) -> None:
        if not self.value and not self.groups:
            raise ValueError("has no flags to clear; give value (a mask) or groups")
        for number, elements in self.elements.items():
            for one in elements:
                if one.code in "fd":
                    raise ValueError(
                        f"{message_layout(number).name}.{one.name} has no flags; give an integer"
                    )

    def numbers(self, count: int) -> list[Numbers]:
        """Return the mask."""
        mask = self.value
        for group in self.groups:
            mask |= GROUPS[group]
        return [(mask,)] * count
