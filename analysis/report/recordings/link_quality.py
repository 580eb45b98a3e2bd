"""Link quality: frames lost, from each sender's sequence numbers (modulo 256), and gaps in time."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.report.curves.recording import LinkQuality, Signal
from analysis.report.recordings.log_clock import LogClock

MOST_STRETCHES, LEAST_FRAMES = 200, 20  # chosen: periods per sender and block; frames per period
FEWEST = 100  # chosen: least frames of a sender for a loss curve

STRETCHES = np.dtype(
    [("sender", "<i4"), ("t_us", "<i8"), ("frames", "<i8"), ("lost", "<i8"), ("gap_us", "<i8")]
)


@dataclass(frozen=True, slots=True)
class LastFrame:
    """The last frame of a sender."""

    seq: int
    t_us: int


def sum_stretches(frames: NDArray[np.void], last: dict[int, LastFrame]) -> NDArray[np.void]:
    """Count frames, losses and gaps of each sender in short periods of a log or a block of it.

    Parameters
    ----------
    frames : structured array, shape (n,)
        As `mavproxy_fault.wire.tlog.Log.frames`.
    last : dict
        The last frame of each sender (system * 256 + component) in the blocks before; updated in
        place.

    Returns
    -------
    structured array
        Per period the sender, the timestamp of its first frame, frames, lost frames and the longest
        time between two frames.
    """
    found = [np.empty(0, STRETCHES)]
    # System and component in one number, for grouping.
    sender = frames["system"].astype(np.int32) << 8 | frames["component"]
    for key in np.unique(sender).tolist():
        rows = frames[sender == key]
        # No loss before a sender's first frame.
        before = last.get(key, LastFrame((int(rows["seq"][0]) - 1) % 256, int(rows["t_us"][0])))
        # Modulo 256, in a wider type.
        steps = np.diff(rows["seq"].astype(np.int16), prepend=np.int16(before.seq)) % 256
        # A limited number of periods, none too short for a loss rate.
        starts = np.arange(0, len(rows), max(LEAST_FRAMES, len(rows) // MOST_STRETCHES))
        some = np.zeros(len(starts), STRETCHES)
        some["sender"] = key
        some["t_us"] = rows["t_us"][starts]
        some["frames"] = np.diff(starts, append=len(rows))
        some["lost"] = np.add.reduceat(np.maximum(steps - 1, 0).astype(np.int64), starts)
        some["gap_us"] = np.maximum.reduceat(np.diff(rows["t_us"], prepend=before.t_us), starts)
        last[key] = LastFrame(int(rows["seq"][-1]), int(rows["t_us"][-1]))
        found.append(some)
    return np.concatenate(found)


def link_quality(
    logs: Mapping[str, NDArray[np.void]], clock: LogClock
) -> tuple[list[LinkQuality], list[Signal]]:
    """Losses of every sender, and their curves; `logs` are rows (k,) of `sum_stretches` by log
    name."""
    links, signals = [], []
    for log, every in logs.items():
        for key in np.unique(every["sender"]).tolist():
            some = every[every["sender"] == key]
            frames, lost = int(some["frames"].sum()), int(some["lost"].sum())
            if frames < 2:
                continue
            longest_s = float(some["gap_us"].max()) * 1e-6
            links.append(LinkQuality(log, key >> 8, key & 255, frames, lost, longest_s))
            if frames >= FEWEST and lost:
                name = f"{key >> 8}/{key & 255} {log}".strip()
                signals.append(_loss(name, clock.at(some["t_us"]), some))
    return links, signals


def _loss(name: str, t_s: NDArray[np.float64], some: NDArray[np.void]) -> Signal:
    """Curve of the percentage of lost frames in equal time bins."""
    # One microsecond more, to include the last timestamp.
    edges = np.linspace(t_s.min(), t_s.max() + 1e-6, max(2, min(2 * MOST_STRETCHES, len(t_s))))
    came = np.histogram(t_s, edges, weights=some["frames"])[0]
    gone = np.histogram(t_s, edges, weights=some["lost"])[0]
    # A bin without frames and losses is a gap (NaN).
    with np.errstate(invalid="ignore"):
        share = 100 * gone / (came + gone)
    return Signal("link-lost", name, (edges[:-1] + edges[1:]) / 2, share)
