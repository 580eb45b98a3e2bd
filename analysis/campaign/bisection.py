"""Find the smallest magnitude at which the outcome gets worse, by bisection.

At most eight flights: one at the upper end, one at the lower, and six halvings, which leave 1/64 of
the interval. If the outcome is not monotonic in the magnitude, bisection finds one of the
magnitudes at which it gets worse.
"""

from collections.abc import Generator
from typing import NamedTuple

from analysis.campaign.campaign_file import Magnitudes

HALVINGS = 6


class CriticalMagnitude(NamedTuple):
    """`magnitude` is the smallest with a bad outcome, `harmless` the largest below it without.

    Without `magnitude` the entire interval is harmless; without `harmless` all of it is bad.
    """

    magnitude: float | None
    harmless: float | None
    flights: int


def bisect_magnitude(interval: Magnitudes) -> Generator[float, bool, CriticalMagnitude]:
    """Yield the magnitudes to fly; the caller sends whether each outcome was bad."""
    # The upper end first: if it is harmless, one flight is enough.
    if not (yield interval.high):
        return CriticalMagnitude(None, interval.high, 1)
    if (yield interval.low):
        return CriticalMagnitude(interval.low, None, 2)
    # Shares of the interval, not magnitudes, since the spacing may be logarithmic.
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if (yield interval.interpolate(middle)):
            high = middle
        else:
            low = middle
    return CriticalMagnitude(interval.interpolate(high), interval.interpolate(low), HALVINGS + 2)
