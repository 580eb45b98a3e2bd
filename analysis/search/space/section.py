"""What the sections of a test file have in common."""

import msgspec

Range = float | tuple[float, float]
"""A number, or the interval that is searched."""


class Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the sections: unknown keys are errors; ranges must have an order."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            # Lists of other lengths are no ranges.
            if isinstance(value, tuple) and len(value) == 2 and value[0] > value[1]:
                raise ValueError(f"{name} = {list(value)} has its ends reversed; [low, high]")
