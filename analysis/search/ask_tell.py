"""Ask-and-tell interface to a minimiser that calls a function: it runs in a thread."""

import threading
from collections.abc import Callable
from queue import Queue

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Function = Callable[[Array], Array]


class AskTellAdapter:
    """Runs `minimise`, which takes a function of points (n, d), one call per `ask` and `report`.

    Only one of the two threads runs at a time, so that nothing depends on the scheduler. The thread
    is a daemon and ends with the process.
    """

    def __init__(self, minimise: Callable[[Function], None]) -> None:
        # Queues of one: neither side can run ahead.
        self._points: Queue[Array] = Queue(1)
        self._values: Queue[Array] = Queue(1)
        self._thread = threading.Thread(target=minimise, args=(self._function,), daemon=True)

    def _function(self, points: Array) -> Array:
        # A copy: some minimisers change their points in place.
        self._points.put(np.array(points))
        return self._values.get()

    def ask(self) -> Array:
        """The points the minimiser evaluates next."""
        # Started by the first call, so that an unused searcher leaves no thread.
        if not self._thread.is_alive():
            self._thread.start()
        return self._points.get()

    def report(self, values: Array) -> None:
        """Return the function values (n,) to the minimiser."""
        self._values.put(np.array(values))
