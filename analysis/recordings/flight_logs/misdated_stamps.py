"""Find wrong timestamps, caused by corrupted bytes, and restarts, by comparison with neighbours."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FAR_US, NEIGHBOURS = 10_000_000, 4  # a wrong timestamp is this far from those before and after
RESTART_US = 1_000_000  # chosen: messages of one instant are logged within a second
FREQUENT_US = 200_000  # chosen: the time between messages of a topic that is logged evenly


def find_misdated(times: NDArray[np.int64], topic: bool = False) -> NDArray[np.bool_]:
    """Mask (n,) of the times, in file order, that are far from all their neighbours.

    A gap or a clock restart differs from one side only and is not marked. Within a `topic` that is
    logged evenly a smaller error shows.
    """
    wrong = np.zeros(len(times), bool)
    steps = np.abs(np.diff(times))
    even = topic and len(steps) > NEIGHBOURS and np.median(steps) < FREQUENT_US
    far_us = RESTART_US if even else FAR_US
    jumps = np.flatnonzero(steps > far_us)
    for i in np.intersect1d(np.union1d(jumps, jumps + 1), np.arange(1, len(times) - 1)).tolist():
        before = times[i] - np.median(times[max(i - NEIGHBOURS, 0) : i])
        behind = times[i] - np.median(times[i + 1 : i + 1 + NEIGHBOURS])
        wrong[i] = min(before, behind) > far_us or max(before, behind) < -far_us
    return wrong


def find_restarts(times: NDArray[Any]) -> NDArray[np.int64]:
    """Indices (k,) at which the times (n,), in us and file order, fall back and stay there: the
    vehicle restarted. A late message or one with a wrong time is no restart."""
    back = np.flatnonzero(np.diff(times) < -RESTART_US) + 1
    lasting = [
        i
        for i in back.tolist()
        if np.median(times[i : i + NEIGHBOURS + 1])
        < np.median(times[max(i - NEIGHBOURS - 1, 0) : i]) - RESTART_US
    ]
    return np.array(lasting, np.int64)
