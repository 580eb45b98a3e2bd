"""Stamps that damaged bytes have made, told by those around them."""

import numpy as np
from numpy.typing import NDArray

FAR_US, AROUND = 10_000_000, 4  # by which no stamp differs from the median of those around it


def misdated(times: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the times (n,) in order of their places are far from all around them."""
    wrong = np.zeros(len(times), bool)
    leaps = np.flatnonzero(np.abs(np.diff(times)) > FAR_US)
    for i in np.union1d(leaps, leaps + 1).tolist():
        around = times[max(i - AROUND, 0) : i + AROUND + 1]
        wrong[i] = abs(times[i] - np.median(around)) > FAR_US
    return wrong
