"""Numbers for the page: float32 in one deflated, base64-coded block, times as offset and step.

The bytes stand in four planes, first all lowest bytes, last all highest: they deflate better.

float32 holds a time of an hour to a quarter of a millisecond only, so a time axis is a line
`offset + step * i` in double precision and, where the samples stray from it, float32 remainders.
"""

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from analysis.report.recordings.recording import Vector
from analysis.report.recordings.thinning import extreme_indices

MAX_CURVE_SAMPLES = 100_000  # samples of one curve; beyond, each bucket keeps its extremes
MAX_SAMPLES = 400_000  # samples of all curves of a page, so that it stays small and opens soon
GAP_STEPS, LEAST_GAP_S = 10.0, 0.5  # a pause longer than both is a gap in a curve
HALF_TURN_DEG = 180.0
EVEN_S = 1e-5  # samples this near the line lie on it

Place = dict[str, float | int]


@dataclass(frozen=True, slots=True)
class PackedNumbers:
    """The numbers gathered so far; `parts` grows.

    Curves of one message share their times: these are put in once.
    """

    parts: list[NDArray[np.float32]] = field(default_factory=list)
    axes: dict[int, Place] = field(default_factory=dict)

    def add_values(self, values: Vector) -> Place:
        """Put values (n,) in; what the page needs to find them: first element and count."""
        at = sum(len(part) for part in self.parts)
        # Little-endian on every machine: the page reads them so.
        self.parts.append(values.astype("<f4"))
        return {"at": at, "n": len(values)}

    def add_times(self, t_s: Vector) -> Place:
        """Put a time axis (n,) in, unless it is there already."""
        # Equal bytes are equal axes: a message of twenty fields stores its times once.
        key = hash(t_s.tobytes())
        if key not in self.axes:
            self.axes[key] = self._new_axis(t_s)
        return self.axes[key]

    def _new_axis(self, t_s: Vector) -> Place:
        n = len(t_s)
        offset = float(t_s[0]) if n else 0.0
        # The line through the first and last sample: a steady clock strays by nothing.
        step = float(t_s[-1] - t_s[0]) / (n - 1) if n > 1 else 0.0
        stray = t_s - (offset + step * np.arange(n))
        place: Place = {"offset": offset, "step": step, "n": n}
        if n and np.abs(stray).max() > EVEN_S:
            place["at"] = self.add_values(stray)["at"]
        return place

    def text(self) -> str:
        """Everything as base64 of zlib's format."""
        data = np.concatenate(self.parts) if self.parts else np.empty(0, "<f4")
        planes = np.ascontiguousarray(data).view(np.uint8).reshape(-1, 4).T
        return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii")


def longest_curve(lengths: Sequence[int], most: int = MAX_SAMPLES) -> int:
    """How long one curve may be for all together to have `most` samples; short ones stay whole."""
    room = most
    for i, length in enumerate(sorted(lengths)):
        # Shortest first: what a short curve does not need is shared among the longer ones.
        share = room // (len(lengths) - i)
        if length > share:
            # Two samples at least, or there is no line.
            return min(MAX_CURVE_SAMPLES, max(share, 2))
        room -= length
    return MAX_CURVE_SAMPLES


def break_at_gaps(t_s: Vector, value: Vector) -> tuple[Vector, Vector]:
    """Times and values (n,) with NaN in the gaps: no line is drawn where there were no samples."""
    # One step has no median to be longer than.
    if len(t_s) < 3:
        return t_s, value
    steps = np.diff(t_s)
    gaps = np.flatnonzero(steps > max(GAP_STEPS * float(np.median(steps)), LEAST_GAP_S))
    # NaN in the middle of the gap: both neighbours keep their own samples.
    middle = (t_s[gaps] + t_s[gaps + 1]) / 2
    return np.insert(t_s, gaps + 1, middle), np.insert(value, gaps + 1, np.nan)


def break_at_wraps(t_s: Vector, angle_deg: Vector) -> tuple[Vector, Vector]:
    """Times and angle (n,) with NaN where it wraps around, so that no line crosses the plot."""
    # A jump over half a turn between two samples is the wrap, not the vehicle.
    wraps = np.flatnonzero(np.abs(np.diff(angle_deg)) > HALF_TURN_DEG)
    middle = (t_s[wraps] + t_s[wraps + 1]) / 2
    return np.insert(t_s, wraps + 1, middle), np.insert(angle_deg, wraps + 1, np.nan)


def thin_curve(
    t_s: Vector, value: Vector, longest: int = MAX_CURVE_SAMPLES
) -> tuple[Vector, Vector]:
    """Times and values (n,), or, if longer, least and greatest of each bucket, in order."""
    n = len(t_s)
    if n <= longest:
        return t_s, value
    # First and last stay: without them the axis would end elsewhere than the flight.
    picked = np.union1d(extreme_indices(value, longest // 2), [0, n - 1])
    return t_s[picked], value[picked]
