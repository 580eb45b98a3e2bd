"""The scores of one flight of a search."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class FlightScores(NamedTuple):
    """Scores of one flight: `error` is the criterion in its unit, `rmse_deg` and `largest_deg` (4,)
    are those of `AXES`; `broken_limit` is the index into `envelope.LIMITS` of what ended it.

    `parts`, where they were asked for: as `score_breakdown` gives them, for the inverse model also
    the RMSE of twelve states and of the inverted sensor models.
    """

    error: float
    rmse_deg: NDArray[np.float64]
    largest_deg: NDArray[np.float64]
    lasted_s: float
    broken_limit: int
    steps: int
    parts: dict[str, Any]
