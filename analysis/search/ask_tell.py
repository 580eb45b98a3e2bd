"""A minimiser that calls its function, turned into ask and tell by a thread of its own."""

import threading
from collections.abc import Callable
from queue import Queue

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Function = Callable[[Array], Array]


class AskTellAdapter:
    """`minimise` is called with a function of points (n, d) and runs while it is asked.

    Only one of the two threads moves at a time, so that nothing depends on the scheduler. The
    thread is a daemon and ends with the process, wherever the minimiser stands.
    """

    def __init__(self, minimise: Callable[[Function], None]) -> None:
        # One place each: neither side can run ahead of the other.
        self._points: Queue[Array] = Queue(1)
        self._values: Queue[Array] = Queue(1)
        self._thread = threading.Thread(target=minimise, args=(self._function,), daemon=True)

    def _function(self, points: Array) -> Array:
        # A copy: some minimisers change their points in place.
        self._points.put(np.array(points))
        return self._values.get()

    def ask(self) -> Array:
        """The points the minimiser wants to know next."""
        # Started by the first question, so that an unused searcher leaves no thread behind.
        if not self._thread.is_alive():
            self._thread.start()
        return self._points.get()

    def tell(self, values: Array) -> None:
        """Their values (n,)."""
        self._values.put(np.array(values))
