"""The compiled form without sockets: for a process that contains both ends of a link."""

import ctypes
import sys
from typing import Any, NamedTuple

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled import object_file
from mavproxy_fault.compiled.compiled_core import CompiledCore
from mavproxy_fault.faults.noise_fault import NoiseFault
from mavproxy_fault.links import datagram_batch
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.wire.frame import HEADER_V1, HEADER_V2, STX_V2

CRC_LENGTH = 2


class Passed(NamedTuple):
    """The result of a datagram: a mask of the links that it leaves on, and the bytes to send."""

    links: int
    data: bytes


class Passage(CompiledCore):
    """Passes datagrams in machine code; leaves those that it cannot process to the core.

    `settle` writes the passed frames to the tape; call it before giving the core data or reading
    its labels.
    """

    def __init__(self, core: Core, tape: CaptureBuffer) -> None:
        super().__init__(core, 0, tape)
        self.loop[k.COMPILED_LINKS] = (1 << len(core.links)) - 1
        self._data = self._arrays["data"]
        function: Any = self._forward
        self._address = ctypes.cast(function, ctypes.c_void_p).value or 0

    def passed(self, link: int, data: bytes, now_us: int) -> Passed | None:
        """Pass a datagram; None if the core has to process it."""
        core, loop, length = self._core, self.loop, len(data)
        due_us = core.next_due_us
        # What is due leaves first.
        if length > k.ROW or (due_us is not None and due_us <= now_us):
            self.settle()
            return None
        self._refresh()
        self._data[:length] = data
        loop[k.LENT], loop[k.LINK], loop[k.CAME] = length, link, now_us
        self._forward(self._addresses)
        mask = loop[k.MASK]
        if mask < 0:
            for frame in split(data):
                self._learn(frame)
            self.settle()
            return None
        # A fault's state has two owners, who must agree before the next frame.
        if self._plans is not None or loop[k.RECEIVED_AT] > k.LOG_MARGIN:
            self._settle()
        return Passed(mask, bytes(self._data[:length]))

    def open_until_us(self) -> int | None:
        """The time until which machine code may call `machine` without the core, before `settle`.

        At that time the core has frames to send; None if it has none.
        """
        self._refresh()
        return self._core.next_due_us

    @property
    def machine(self) -> tuple[int, int]:
        """Addresses of the compiled function and of its argument; the datagram is in `data`."""
        return self._address, ctypes.addressof(self._addresses)

    @property
    def data(self) -> memoryview:
        """Room for a datagram."""
        return memoryview(self._data)

    def settle(self) -> None:
        """Add the faults' counts to the engine, and the passed frames to the tape."""
        if self.loop[k.RECEIVED_AT]:
            self._settle()

    def count(self) -> None:
        """Add the machine code's counts to the core's."""
        self.settle()
        ports = self.ports
        for number, state in enumerate(self._core.states):
            state.frames += ports[number, k.FRAMES]
            state.gaps += ports[number, k.MISSING]
            state.faulted += ports[number, k.FAULTED]
            for column in (k.FRAMES, k.MISSING, k.FAULTED):
                ports[number, column] = 0

    def _way(self, number: int) -> tuple[int, int]:
        engine: Any = self._core.engine
        acting = (
            () if engine is None or engine.t0_us is None else engine.active_entries(number) or ()
        )
        # Numbers drawn ahead for one datagram cost more than the noise of it.
        if any(isinstance(running.fault, NoiseFault) for running in acting):
            return k.INTERPRETED, -1
        return super()._way(number)


def split(data: bytes) -> list[bytes]:
    """The frames of a datagram, which are whole and not signed."""
    found, at = [], 0
    while at + 1 < len(data):
        head = HEADER_V2 if data[at] == STX_V2 else HEADER_V1
        end = at + head + data[at + 1] + CRC_LENGTH
        found.append(data[at:end])
        at = end
    return found


def new_passage(core: Core, tape: CaptureBuffer) -> Passage | None:
    """A passage, whose machine code is made where there is none yet; None where it cannot be."""
    if not datagram_batch.HAS_RECVMMSG:
        return None
    if object_file.load() is None:
        print("first use: compiling machine code, once, which takes up to a minute",
              file=sys.stderr, flush=True)  # fmt: skip
        object_file.make()
    return Passage(core, tape)
