"""What is solved once by linear algebra, the same on all processors."""

import numpy as np
from numpy.typing import NDArray

DECIMALS = 12  # later ones depend on the processor, for which the library chooses its code


def round_solution(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values of any shape without the digits on which processors disagree; zero unsigned."""
    return np.asarray(np.round(values, DECIMALS) + 0.0, np.float64)
