"""Pack the numbers of a page: float32 in one deflated, base64-coded block.

The bytes are stored in four planes, from all lowest to all highest bytes, which compresses better.

float32 resolves one hour to a quarter of a millisecond only, so a time axis is stored as a line
`offset + step * i` in double precision, plus float32 residuals if the samples are uneven.
"""

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from analysis.report.curves.recording import Span, Vector
from analysis.report.recordings.thinning import extreme_indices

MAX_CURVE_SAMPLES = 100_000  # per curve; longer ones are thinned to their extremes
MAX_SAMPLES = 400_000  # of all curves of a page; chosen to keep the file small
GAP_STEPS, LEAST_GAP_S = 10.0, 0.5  # chosen: a pause longer than both is a gap
MOST_SPANS = 1000  # of a lane: a screen has hardly more pixels beside the lanes' names
HALF_TURN_DEG = 180.0
EVEN_S = 1e-5  # residuals below it are not stored

Place = dict[str, float | int]


@dataclass(frozen=True, slots=True)
class PackedNumbers:
    """Collects the numbers of a page.

    Time axes shared by several curves are stored once.
    """

    parts: list[NDArray[np.float32]] = field(default_factory=list)
    axes: dict[int, Place] = field(default_factory=dict)

    def add_values(self, values: Vector) -> Place:
        """Add values (n,); returns their first element and count."""
        at = sum(len(part) for part in self.parts)
        # Little-endian, as the page expects; a number beyond its type's range is a wrong one.
        inside = np.abs(values) < np.finfo("f4").max
        self.parts.append(np.where(inside, values, np.nan).astype("<f4"))
        return {"at": at, "n": len(values)}

    def add_times(self, t_s: Vector) -> Place:
        """Add a time axis (n,), unless it is already stored."""
        # All fields of a message share their times.
        key = hash(t_s.tobytes())
        if key not in self.axes:
            self.axes[key] = self._new_axis(t_s)
        return self.axes[key]

    def _new_axis(self, t_s: Vector) -> Place:
        n = len(t_s)
        offset = float(t_s[0]) if n else 0.0
        # The line through the first and last sample: even sampling has no residuals.
        step = float(t_s[-1] - t_s[0]) / (n - 1) if n > 1 else 0.0
        stray = t_s - (offset + step * np.arange(n))
        place: Place = {"offset": offset, "step": step, "n": n}
        if n and np.abs(stray).max() > EVEN_S:
            place["at"] = self.add_values(stray)["at"]
        return place

    def text(self) -> str:
        """All values, zlib-compressed and base64-coded."""
        data = np.concatenate(self.parts) if self.parts else np.empty(0, "<f4")
        planes = np.ascontiguousarray(data).view(np.uint8).reshape(-1, 4).T
        return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode("ascii")


def longest_curve(lengths: Sequence[int], most: int = MAX_SAMPLES) -> int:
    """Length limit per curve that keeps the total at `most` samples; short curves stay complete."""
    room = most
    for i, length in enumerate(sorted(lengths)):
        # Shortest first: longer curves share what short ones do not need.
        share = room // (len(lengths) - i)
        if length > share:
            # A line needs two samples.
            return min(MAX_CURVE_SAMPLES, max(share, 2))
        room -= length
    return MAX_CURVE_SAMPLES


def break_at_gaps(t_s: Vector, value: Vector) -> tuple[Vector, Vector]:
    """Insert NaN in gaps of a curve (n,), so that no line is drawn across them."""
    # A gap is longer than the median step; fewer samples have none.
    if len(t_s) < 3:
        return t_s, value
    steps = np.diff(t_s)
    return _broken(t_s, value, steps > max(GAP_STEPS * float(np.median(steps)), LEAST_GAP_S))


def break_at_wraps(t_s: Vector, angle_deg: Vector) -> tuple[Vector, Vector]:
    """Insert NaN where an angle (n,) wraps around, so that no line crosses the plot."""
    # A jump of more than half a turn is a wrap.
    return _broken(t_s, angle_deg, np.abs(np.diff(angle_deg)) > HALF_TURN_DEG)


def _broken(t_s: Vector, value: Vector, breaks: NDArray[np.bool_]) -> tuple[Vector, Vector]:
    at = np.flatnonzero(breaks)
    return np.insert(t_s, at + 1, (t_s[at] + t_s[at + 1]) / 2), np.insert(value, at + 1, np.nan)


def thin_spans(spans: Sequence[Span]) -> list[Span]:
    """The spans of a timeline; on a lane with more than `MOST_SPANS` equal ones that are less than
    a pixel apart are one."""
    lanes: dict[str, list[Span]] = {}
    for span in spans:
        lanes.setdefault(span.lane, []).append(span)
    found: list[Span] = []
    for some in lanes.values():
        if len(some) > MOST_SPANS:
            length_s = max(span.end_s for span in some) - min(span.start_s for span in some)
            some = _merged_spans(some, length_s / MOST_SPANS)
        found += some
    return found


def _merged_spans(spans: Sequence[Span], pixel_s: float) -> list[Span]:
    last: dict[tuple[str, str], int] = {}
    found: list[Span] = []
    for span in sorted(spans, key=lambda span: span.start_s):
        at = last.get((span.text, span.kind), -1)
        if at >= 0 and span.start_s - found[at].end_s < pixel_s:
            found[at] = found[at]._replace(end_s=max(found[at].end_s, span.end_s))
        else:
            last[span.text, span.kind] = len(found)
            found.append(span)
    return found


def thin_curve(
    t_s: Vector, value: Vector, longest: int = MAX_CURVE_SAMPLES
) -> tuple[Vector, Vector]:
    """Thin a curve (n,) longer than `longest` to the minimum and maximum of each bucket."""
    n = len(t_s)
    if n <= longest:
        return t_s, value
    # Keep the first and last sample, so that the axis keeps its ends.
    picked = np.union1d(extreme_indices(value, longest // 2), [0, n - 1])
    return t_s[picked], value[picked]
