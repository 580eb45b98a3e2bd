"""Ctrl-C and SIGTERM end the work between two steps, so that all that is written stays whole."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

StopCheck = Callable[[], bool]  # whether somebody wants the work to end
STOPPING = b"\nstopping; once more ends at once\n"


@contextlib.contextmanager
def stop_requests() -> Iterator[StopCheck]:
    """Requests to stop are told by what this gives; one after the first interrupts the work."""
    asked = threading.Event()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, action in before.items():
            signal.signal(number, action)

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()
        # The old handlers are back: the second Ctrl-C interrupts at once.
        restore()
        # `print` from a signal handler may find the stream's lock taken.
        os.write(2, STOPPING)

    for number in before:
        signal.signal(number, ask)
    try:
        yield asked.is_set
    finally:
        restore()
