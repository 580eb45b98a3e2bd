"""Stamps that damaged bytes have made, told by those around them."""

import numpy as np
from numpy.typing import NDArray

FAR_US, NEIGHBOURS = 10_000_000, 4  # by which a stamp lies beyond those before it and behind it


def find_misdated(times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the times (n,) in order of their places are far from all around them.

    A pause lies behind what came before it only, and so does a new start of the clock.
    """
    wrong = np.zeros(len(times), bool)
    leaps = np.flatnonzero(np.abs(np.diff(times)) > FAR_US)
    for i in np.intersect1d(np.union1d(leaps, leaps + 1), np.arange(1, len(times) - 1)).tolist():
        before = times[i] - np.median(times[max(i - NEIGHBOURS, 0) : i])
        behind = times[i] - np.median(times[i + 1 : i + 1 + NEIGHBOURS])
        wrong[i] = min(before, behind) > FAR_US or max(before, behind) < -FAR_US
    return wrong
