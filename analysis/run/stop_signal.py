"""End the work between two steps on Ctrl-C or SIGTERM, so that all files stay complete."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

StopCheck = Callable[[], bool]  # whether the user has requested a stop
STOPPING = b"\nstopping; press Ctrl-C again to end at once\n"


@contextlib.contextmanager
def stop_requests() -> Iterator[StopCheck]:
    """Yield a function that reports a stop request; a second request interrupts the work."""
    asked = threading.Event()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, action in before.items():
            signal.signal(number, action)

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()
        # With the old handlers, a second Ctrl-C interrupts at once.
        restore()
        # `print` in a signal handler could deadlock on the stream's lock.
        os.write(2, STOPPING)

    for number in before:
        signal.signal(number, ask)
    try:
        yield asked.is_set
    finally:
        restore()
