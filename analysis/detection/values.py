"""Values with named fields that are made and changed in C: an epoch makes some twenty of them."""

from typing import TYPE_CHECKING, Any, Self

import msgspec


class Value(msgspec.Struct, frozen=True):
    """Fields in order, as those of a named tuple; nothing checks their types."""

    if TYPE_CHECKING:

        def _replace(self, **changes: Any) -> Self:
            """The value with other fields."""

    else:
        _replace = msgspec.Struct.__replace__  # C's own: a call of ours around it doubles its time
