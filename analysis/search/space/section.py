"""Base class of the sections of a test file, and the values of one."""

from collections.abc import Mapping

import msgspec

Range = float | tuple[float, float]
"""A fixed number, or the interval to search."""


class Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the sections: unknown keys are errors; ranges must be ordered."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            # Tuples of other lengths are not ranges.
            if isinstance(value, tuple) and len(value) == 2 and value[0] > value[1]:
                raise ValueError(f"{name} = {list(value)} has its ends reversed; write [low, high]")


def section_values(values: Mapping[str, float], section: str) -> dict[str, float]:
    """The values of one section of a test file, by the names of its keys."""
    head = section + "."
    return {k.removeprefix(head): float(v) for k, v in values.items() if k.startswith(head)}
