"""Find wrong timestamps, caused by corrupted bytes, by comparison with their neighbours."""

import numpy as np
from numpy.typing import NDArray

FAR_US, NEIGHBOURS = 10_000_000, 4  # a wrong timestamp is this far from those before and after


def find_misdated(times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mask (n,) of the times, in file order, that are far from all their neighbours.

    A gap or a clock restart differs from one side only and is not marked.
    """
    wrong = np.zeros(len(times), bool)
    jumps = np.flatnonzero(np.abs(np.diff(times)) > FAR_US)
    for i in np.intersect1d(np.union1d(jumps, jumps + 1), np.arange(1, len(times) - 1)).tolist():
        before = times[i] - np.median(times[max(i - NEIGHBOURS, 0) : i])
        behind = times[i] - np.median(times[i + 1 : i + 1 + NEIGHBOURS])
        wrong[i] = min(before, behind) > FAR_US or max(before, behind) < -FAR_US
    return wrong
