"""Comparison of estimates with the interpolated truth: see `attitude_scoring`."""

from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from analysis.samples.block import Indices, Stamps
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.rotations.rotation_kernel import attitude_errors, interpolate_attitude

MAX_TRUTH_GAP_US = 1_000_000  # truth is not interpolated over a longer gap: motion in it is unknown
MAX_LATENESS_US = 1_000_000  # truth is kept so long for late estimates, as on a radio link


class ScoredEstimates(NamedTuple):
    """Scored estimates (m,): index, block row that completed the score, index of the truth just
    after; error (m, 4) of roll, pitch, yaw and total angle in rad, pi where the estimate is NaN."""

    estimator_index: Indices
    row: Indices
    truth: Indices
    error: Vector


def _bracketing_truth(
    truth_us: Sequence[int], oldest: int, newest: int, t_us: int
) -> tuple[int, int] | None:
    """Indices of the truth just before and after a time that is not after the newest; None if no
    pair is close enough."""
    # Nearly always the estimate lies between the two newest truths.
    first, second = newest - 1, newest
    if t_us < truth_us[first]:
        if t_us < truth_us[oldest]:
            return None
        low = bisect_left(truth_us, t_us, oldest, newest)
        # On the oldest truth itself there is none before: use the pair from there on.
        first, second = max(low - 1, oldest), max(low, oldest + 1)
    # Truth is not interpolated between two flights or over a gap.
    return (first, second) if 0 < truth_us[second] - truth_us[first] <= MAX_TRUTH_GAP_US else None


def score_estimates(
    truth_row: Indices,
    truth_us: Stamps,
    truth_q: Vector,
    row: Indices,
    t_us: Stamps,
    q_nb: Vector,
) -> tuple[ScoredEstimates, Indices, int]:
    """Score each estimate once the truth has passed it.

    truth_row, truth_us (k,) and truth_q (k, 4) are the block row of each truth (-1: before the
    block), its stamp and attitude; row, t_us (n,) and q_nb (n, 4) the same of estimates. Returns
    the scored estimates, the indices (w,) of those the truth has not passed yet, and the first
    truth that is still needed.
    """
    found: list[tuple[int, int, int, int]] = []
    stamps, times = t_us.tolist(), truth_us.tolist()
    waiting: list[int] = []
    begin = oldest = 0
    ends = np.searchsorted(row, truth_row).tolist()
    for j, (end, own_row) in enumerate(zip(ends, truth_row.tolist(), strict=True)):
        waiting += range(begin, end)
        begin = max(begin, end)
        # Only a truth of this block can complete a score, and only with a newer stamp.
        if j > 0 and own_row >= 0 and times[j] > times[j - 1]:
            for i in waiting:
                if stamps[i] <= times[j] and (
                    pair := _bracketing_truth(times, oldest, j, stamps[i])
                ):
                    found.append((i, own_row, *pair))
            waiting = [i for i in waiting if stamps[i] > times[j]]
        # Drop old truth: autopilots' estimates come late, but not later than this.
        while times[oldest] < times[j] - MAX_LATENESS_US and j - oldest > 1:
            oldest += 1
    waiting += range(begin, len(row))
    index, rows, first, second = np.array(found, np.int64).reshape(-1, 4).T
    share = (t_us[index] - truth_us[first]) / (truth_us[second] - truth_us[first])
    error = _compare(q_nb[index], truth_q[first, :4], truth_q[second, :4], share)
    # The largest error: an estimator must not gain by returning NaN.
    error[~np.isfinite(error).all(axis=1)] = np.pi
    return ScoredEstimates(index, rows, second, error), np.array(waiting, np.int64), oldest


@compiled
def _compare(q_nb: Vector, before: Vector, after: Vector, share: Vector) -> Vector:
    """The errors (m, 4) of estimates (m, 4) against the truth interpolated between two (m, 4)."""
    out = np.empty((len(share), 4))
    for i in range(len(share)):
        p, q = before[i], after[i]
        true = interpolate_attitude((p[0], p[1], p[2], p[3]), (q[0], q[1], q[2], q[3]), share[i])
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = attitude_errors(q_nb[i], true)
    return out
