"""Values with named fields that are made and changed in C: an epoch makes some twenty of them."""

from typing import Any, Self

import msgspec


class Value(msgspec.Struct, frozen=True):
    """Fields in order, as those of a named tuple; nothing checks their types."""

    def _replace(self, **changes: Any) -> Self:
        """The value with other fields."""
        return msgspec.structs.replace(self, **changes)
