"""The smallest magnitude at which the outcome gets worse, by halving the interval.

Eight flights at most: one at the upper end, one at the lower, six halvings, after which the
interval is a sixty-fourth of the first. Outcomes need not grow with the magnitude everywhere; what
is found is one place at which they get worse.
"""

from collections.abc import Generator
from dataclasses import dataclass

from analysis.campaign.campaign_file import Magnitudes

HALVINGS = 6


@dataclass(frozen=True)
class CriticalMagnitude:
    """`magnitude` is the smallest found that is worse, `harmless` the largest below it that is not.

    Without `magnitude` the whole interval is harmless; without `harmless` all of it is worse.
    """

    magnitude: float | None
    harmless: float | None
    flights: int


def bisect_magnitude(interval: Magnitudes) -> Generator[float, bool, CriticalMagnitude]:
    """Yields magnitudes to fly and is sent whether each was worse."""
    # The upper end first: where it does no harm, one flight answers the question.
    if not (yield interval.high):
        return CriticalMagnitude(None, interval.high, 1)
    if (yield interval.low):
        return CriticalMagnitude(interval.low, None, 2)
    # Shares of the way and not magnitudes: the spacing may be logarithmic.
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if (yield interval.interpolate(middle)):
            high = middle
        else:
            low = middle
    return CriticalMagnitude(interval.interpolate(high), interval.interpolate(low), HALVINGS + 2)
