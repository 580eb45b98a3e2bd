"""The compiled core for a process that contains both ends of a link."""

import ctypes
import sys
from typing import Any

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled import object_file
from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.links import udp
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core


class Passage(CompiledCore):
    """A compiled core whose machine code others may call.

    They put a datagram in `room`, its length in LENT, its link and its time in nanoseconds in LINK
    and CAME of `loop`, and call `machine`. If MASK is a set of links, the datagram leaves on them
    as it is in `room` then; else `finish` gives what leaves. Call `settle` before giving the core
    data or reading its labels.
    """

    def __init__(self, core: Core, tape: CaptureBuffer) -> None:
        super().__init__(core, 0, tape)
        function: Any = self._forward
        self._address = ctypes.cast(function, ctypes.c_void_p).value or 0

    def open_until_us(self) -> int | None:
        """The time until which machine code may call `machine` without the core, before `settle`.

        At that time the core has frames to send; None if it has none.
        """
        self._refresh()
        return self._core.next_due_us

    @property
    def machine(self) -> tuple[int, int]:
        """Addresses of the compiled function and of its argument; the datagram is in `room`."""
        return self._address, ctypes.addressof(self._addresses)

    @property
    def room(self) -> memoryview:
        """Room for a datagram."""
        return memoryview(self.shared.data)

    def settle(self) -> None:
        """Give the core what was counted, and the passed frames to the tape."""
        self._settle((self.loop[k.BASE] + self.loop[k.CAME]) // 1000)
        self._core_ran = True


def new_passage(core: Core, tape: CaptureBuffer) -> Passage | None:
    """A passage, whose machine code is made where there is none yet; None where it cannot be."""
    if not udp.IS_LINUX:
        return None
    if object_file.load() is None:
        print("first use: compiling machine code, once, which takes up to a minute",
              file=sys.stderr, flush=True)  # fmt: skip
        object_file.make()
    return Passage(core, tape)
