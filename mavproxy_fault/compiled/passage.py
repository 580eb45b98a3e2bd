"""The compiled core for a process that contains both ends of a link."""

import sys

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled import object_file
from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.links import datagram_batch
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core


class Passage(CompiledCore):
    """A compiled core that is called directly; `settle` before reading its labels."""

    def __init__(self, core: Core, tape: CaptureBuffer) -> None:
        super().__init__(core, 0, tape)

    def settle(self) -> None:
        """Give the core what was counted, and the passed frames to the tape."""
        self._settle((self.loop[k.BASE] + self.loop[k.CAME]) // 1000)
        self._core_ran = True


def new_passage(core: Core, tape: CaptureBuffer) -> Passage | None:
    """A passage, whose machine code is made where there is none yet; None where it cannot be."""
    if not datagram_batch.HAS_RECVMMSG:
        return None
    if object_file.load() is None:
        print("first use: compiling machine code, once, which takes up to a minute",
              file=sys.stderr, flush=True)  # fmt: skip
        object_file.make()
    return Passage(core, tape)
