"""Memory of faults: regions of one array of numbers that Python and compiled code share.

What a rule remembers of a sender (a frozen value, the state of a channel) lies here, so it may be
called from either side at any frame.
"""

import math
import mmap
import struct
import threading
from array import array
from typing import Any

NUMBERS = 1 << 22  # 32 MB of address space; pages are used only when touched


def new_table(kind: str, *shape: int) -> Any:
    """Zeroed memory as a view of numbers of one kind; pages cost nothing before they are used."""
    size = struct.calcsize(kind) * math.prod(shape)
    octets: Any = memoryview(mmap.mmap(-1, max(size, 1)))
    return octets[:size] if kind == "B" else octets[:size].cast(kind, shape)


ARENA: Any = new_table("d", NUMBERS)
_free: dict[int, list[int]] = {}  # offsets of released regions, by size
_used = 0
_lock = threading.Lock()


class Memory:
    """A region of zeros, `numbers`, released with its last reference."""

    __slots__ = ("at", "numbers", "size")

    def __init__(self, size: int) -> None:
        global _used
        with _lock:  # entries are prepared in other threads
            self.size, released = size, _free.get(size)
            if released:
                at = released.pop()
                ARENA[at : at + size] = array("d", bytes(8 * size))
            elif _used + size > NUMBERS:
                raise MemoryError("the faults' memory is full")
            else:
                at, _used = _used, _used + size
        self.at, self.numbers = at, ARENA[at : at + size]

    def write(self, numbers: list[float]) -> None:
        """Set the first numbers of the region."""
        self.numbers[: len(numbers)] = array("d", numbers)

    def __del__(self, released: dict[int, list[int]] = _free) -> None:  # at exit names are gone
        if hasattr(self, "at"):
            released.setdefault(self.size, []).append(self.at)


NO_MEMORY = Memory(0)  # of rules that remember nothing
