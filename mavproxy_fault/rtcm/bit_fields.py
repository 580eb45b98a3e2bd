"""Bit fields as RTCM packs them: most significant bit first, signed fields in two's complement."""

from collections.abc import Iterable, Sequence


class BitReader:
    """Reads consecutive fields from the first bit of `data`."""

    __slots__ = ("_remaining_bits", "_value")

    def __init__(self, data: bytes) -> None:
        # As one large integer, a field at any offset is a shift and a mask.
        self._value = int.from_bytes(data, "big")
        self._remaining_bits = 8 * len(data)

    def column(self, count: int, width: int) -> list[int]:
        """Read `count` numbers of `width` bits; negative: in two's complement.

        Raises
        ------
        ValueError
            If fewer bits remain.
        """
        size = abs(width)
        self._remaining_bits -= count * size
        if self._remaining_bits < 0:
            raise ValueError("message ends inside a field")
        mask, sign = (1 << size) - 1, (1 << size - 1 if width < 0 else 0)
        # Cut out first, since each shift copies the whole integer.
        run = self._value >> self._remaining_bits & (1 << count * size) - 1
        values = [run >> at & mask for at in range((count - 1) * size, -1, -size)]
        return [(value ^ sign) - sign for value in values] if sign else values

    def unsigned(self, width: int) -> int:
        """Read one unsigned number."""
        return self.column(1, width)[0]


def pack_columns(columns: Iterable[tuple[Sequence[int], int]]) -> bytes:
    """Pack columns of fields, each of one width, padded with zero bits to a complete byte.

    Negative values are packed as two's complement.

    Raises
    ------
    ValueError
        If a value does not fit its width.
    """
    packed = length = 0
    for values, width in columns:
        if not values:
            continue
        # Accepts signed and unsigned values, since the sign of a field is unknown here.
        if not (-(1 << (width - 1)) <= min(values) and max(values) < 1 << width):
            wrong = next(v for v in values if not -(1 << (width - 1)) <= v < 1 << width)
            raise ValueError(f"{wrong} does not fit {width} bits")
        mask = (1 << width) - 1
        # Packed separately first, since each shift of the message copies all of it.
        run = 0
        for value in values:
            run = run << width | value & mask
        packed = packed << width * len(values) | run
        length += width * len(values)
    padding = -length % 8
    return (packed << padding).to_bytes((length + padding) // 8, "big")
