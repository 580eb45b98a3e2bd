"""Link quality: frames lost, from each sender's sequence numbers (modulo 256), and gaps in time."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from analysis.recordings.flight_logs.message_clock import LogClock
from analysis.report.curves.recording import LinkQuality, Signal

MOST_STRETCHES, LEAST_FRAMES = 200, 20  # chosen: periods per sender and block; frames per period
FEWEST = 100  # chosen: least frames of a sender for a loss curve

INTEGERS = ("t_us", "frames", "lost", "gap_us", "gap_at_us")
STRETCHES = np.dtype([("sender", "<i4"), *((name, "<i8") for name in INTEGERS)])


LastFrame = tuple[int, int]  # sequence number and timestamp


def sum_stretches(
    frames: NDArray[np.void],
    last: dict[int, LastFrame],
    restarts_us: Sequence[tuple[int, int]] = (),
) -> NDArray[np.void]:
    """Count frames, losses and gaps of each sender in short periods of a log or a block of it.

    `frames` (n,) are as `mavproxy_fault.wire.tlog.Log.frames`. `last` has the last frame of each
    sender (system * 256 + component) in the blocks before, and is updated. `restarts_us` are the
    timestamps of the last frame before a restart of the vehicle, which numbers frames anew, and of
    the first one behind it. A row of the result has the sender of a period, the timestamp of its
    first frame, frames, lost frames, the longest time between two frames and its beginning.
    """
    found = [np.empty(0, STRETCHES)]
    # System and component in one number, for grouping.
    sender = frames["system"].astype(np.int32) << 8 | frames["component"]
    for key in np.unique(sender).tolist():
        rows = frames[sender == key]
        # No loss before a sender's first frame.
        seq, t_us = last.get(key, ((int(rows["seq"][0]) - 1) % 256, int(rows["t_us"][0])))
        # Modulo 256, in a wider type.
        steps = np.diff(rows["seq"].astype(np.int16), prepend=np.int16(seq)) % 256
        for last_us, first_us in restarts_us:
            steps[(rows["t_us"] > last_us) & (rows["t_us"] <= first_us)] = 1
        # A limited number of periods, none too short for a loss rate.
        starts = np.arange(0, len(rows), max(LEAST_FRAMES, len(rows) // MOST_STRETCHES))
        some = np.zeros(len(starts), STRETCHES)
        some["sender"] = key
        some["t_us"] = rows["t_us"][starts]
        some["frames"] = np.diff(starts, append=len(rows))
        some["lost"] = np.add.reduceat(np.maximum(steps - 1, 0).astype(np.int64), starts)
        gaps = np.diff(rows["t_us"], prepend=t_us)
        parts = zip(starts.tolist(), np.split(gaps, starts[1:]), strict=True)
        longest = [begin + int(part.argmax()) for begin, part in parts]
        some["gap_us"] = gaps[longest]
        some["gap_at_us"] = rows["t_us"][longest] - gaps[longest]
        last[key] = int(rows["seq"][-1]), int(rows["t_us"][-1])
        found.append(some)
    return np.concatenate(found)


def link_quality(
    logs: Mapping[str, NDArray[np.void]],
    clock: LogClock,
    armed: Sequence[tuple[float, float]] | None,
) -> tuple[list[LinkQuality], list[Signal]]:
    """Losses and silences of every sender, and curves of the losses.

    `logs` are rows (k,) of `sum_stretches` by log name. Only silences within the windows `armed`
    count; all if there is none.
    """
    links, signals = [], []
    for log, every in logs.items():
        for key in np.unique(every["sender"]).tolist():
            some = every[every["sender"] == key]
            if (total := int(some["frames"].sum())) < 2:
                continue
            t_s, gap_s = clock.at(some["t_us"]), some["gap_us"] * 1e-6
            begin_s = clock.at(some["gap_at_us"])
            longest_s = _longest(begin_s, gap_s, armed) if armed else float(gap_s.max())
            lost = int(some["lost"].sum())
            links.append(LinkQuality(log, key >> 8, key & 255, total, lost, longest_s))
            if total >= FEWEST and some["lost"].any():
                name = f"{key >> 8}/{key & 255} {log}".strip()
                signals.append(_loss(name, t_s, some))
    return links, signals


def _longest(
    begin_s: NDArray[np.float64], gap_s: NDArray[np.float64], armed: Sequence[tuple[float, float]]
) -> float:
    """The longest part of a silence (n,) within an armed window."""
    (starts, stops), longest_s = np.array(armed).T, 0.0
    for i in np.argsort(-gap_s).tolist():
        if gap_s[i] <= longest_s:
            break
        inside = np.minimum(begin_s[i] + gap_s[i], stops) - np.maximum(begin_s[i], starts)
        longest_s = max(longest_s, float(inside.max()))
    return longest_s


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
