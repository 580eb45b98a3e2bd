"""What a fault has done since it began: numbers in memory that Python and compiled code share."""

import math
from typing import Any

FRAMES, SATURATED, WAYS, FIRST_US, LARGEST = range(5)  # WAYS: directions, a bit mask
SEALED = 5  # signed frames that it could not change, in all activations
COUNTS = 6


def note_hits(
    m: Any, t_us: float, from_vehicle: int, frames: int, saturated: int, largest: float
) -> None:
    """Count changed frames and their largest change, negative for none; a rule (`rules`)."""
    if m[FRAMES] == 0.0:
        m[FIRST_US], m[LARGEST] = float(t_us), -1.0
    m[FRAMES] += frames
    m[SATURATED] += saturated
    m[WAYS] = float(int(m[WAYS]) | 1 << from_vehicle)
    if m[LARGEST] < largest < math.inf:  # infinity would spoil the maximum permanently
        m[LARGEST] = largest
