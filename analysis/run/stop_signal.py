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
    requested = threading.Event()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, action in handlers.items():
            signal.signal(number, action)

    def on_signal(number: int, frame: FrameType | None) -> None:
        requested.set()
        # With the old handlers, a second Ctrl-C interrupts at once.
        restore()
        # `print` in a signal handler could deadlock on the stream's lock.
        os.write(2, STOPPING)

    for number in handlers:
        signal.signal(number, on_signal)
    try:
        yield requested.is_set
    finally:
        restore()
