"""Compiled comparison of estimates with the interpolated truth: see `attitude_scoring`."""

from math import isfinite, pi
from typing import NamedTuple

import numpy as np

from analysis.samples.block import Indices, Stamps
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.rotations.rotation_kernel import (
    Quaternion,
    attitude_errors,
    interpolate_attitude,
)

MAX_TRUTH_GAP_US = 1_000_000  # truth is not interpolated over a longer gap: motion in it is unknown
MAX_LATENESS_US = 1_000_000  # truth is kept so long for late estimates, as on a radio link


class ScoredEstimates(NamedTuple):
    """Scored estimates (m,): index, block row that completed the score, index of the truth just
    after; error (m, 4) of roll, pitch, yaw and total angle in rad, pi where the estimate is NaN."""

    estimator_index: Indices
    row: Indices
    truth: Indices
    error: Vector


@compiled
def bracketing_truth(truth_us: Stamps, oldest: int, newest: int, t_us: int) -> tuple[int, int]:
    """Indices of the truth just before and after a time that is not after the newest of the stamps
    `truth_us` (k,); (-1, -1) if no pair is close enough."""
    # Nearly always the estimate lies between the two newest truths.
    first, second = newest - 1, newest
    if t_us < truth_us[first]:
        low, high = oldest, newest
        while low < high:
            middle = (low + high) // 2
            if truth_us[middle] < t_us:
                low = middle + 1
            else:
                high = middle
        if t_us < truth_us[oldest]:
            return -1, -1
        # On the oldest truth itself there is none before: use the pair from there on.
        first, second = max(low - 1, oldest), max(low, oldest + 1)
    # Truth is not interpolated between two flights or over a gap.
    span_us = truth_us[second] - truth_us[first]
    return (first, second) if 0 < span_us <= MAX_TRUTH_GAP_US else (-1, -1)


@compiled
def quaternion_at(q_nb: Vector, row: int) -> Quaternion:
    """Row `row` of q_nb (n, 4)."""
    return q_nb[row, 0], q_nb[row, 1], q_nb[row, 2], q_nb[row, 3]


@compiled
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
    count = len(row)
    scored = ScoredEstimates(
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        np.empty(count, np.int64),
        np.empty((count, 4)),
    )
    waiting = np.empty(count, np.int64)
    waiting_count = done = next_estimate = oldest = 0
    for j in range(len(truth_us)):
        while next_estimate < count and row[next_estimate] < truth_row[j]:
            waiting[waiting_count] = next_estimate
            waiting_count += 1
            next_estimate += 1
        # Only a truth of this block can complete a score, and only with a newer stamp.
        if j > 0 and truth_row[j] >= 0 and truth_us[j] > truth_us[j - 1]:
            kept = 0
            for k in range(waiting_count):
                i = waiting[k]
                if t_us[i] > truth_us[j]:
                    waiting[kept] = i
                    kept += 1
                    continue
                first, second = bracketing_truth(truth_us, oldest, j, t_us[i])
                if first >= 0:
                    share = (t_us[i] - truth_us[first]) / (truth_us[second] - truth_us[first])
                    true = interpolate_attitude(
                        quaternion_at(truth_q, first), quaternion_at(truth_q, second), share
                    )
                    _score(scored, done, quaternion_at(q_nb, i), true)
                    scored.estimator_index[done], scored.row[done] = i, truth_row[j]
                    scored.truth[done] = second
                    done += 1
            waiting_count = kept
        # Drop old truth: autopilots' estimates come late, but not later than this.
        while truth_us[oldest] < truth_us[j] - MAX_LATENESS_US and j - oldest > 1:
            oldest += 1
    while next_estimate < count:
        waiting[waiting_count] = next_estimate
        waiting_count += 1
        next_estimate += 1
    completed = ScoredEstimates(
        scored.estimator_index[:done], scored.row[:done], scored.truth[:done], scored.error[:done]
    )
    return completed, waiting[:waiting_count], oldest


@compiled
def _score(scored: ScoredEstimates, at: int, estimate: Quaternion, true: Quaternion) -> None:
    """Write the error of one estimate; 180 degrees where it is NaN."""
    roll, pitch, yaw, angle = attitude_errors(estimate, true)
    if not isfinite(roll + pitch + yaw + angle):
        # The largest error: an estimator must not gain by returning NaN.
        roll, pitch, yaw, angle = pi, pi, pi, pi
    scored.error[at, 0], scored.error[at, 1] = roll, pitch
    scored.error[at, 2], scored.error[at, 3] = yaw, angle


@compiled
def accumulate_errors(
    source: Indices, bin_us: Stamps, error: Vector, last_us: Stamps, sums: Vector
) -> tuple[Indices, Stamps, Vector]:
    """Add errors to the time bins of their sources.

    Parameters
    ----------
    source, bin_us, error : (m,), (m,), (m, 4)
        Source of each error, start of its bin, and the error.
    last_us, sums : (s,), (s, 9)
        Newest bin of each source and its sums: count, sums of squares, maxima.

    Returns
    -------
    opened : (c,)
        Errors that opened a new bin.
    last_us, sums : (s,), (s + c, 9)
        As above, followed by the sums of the new bins.
    """
    sources = len(last_us)
    last_us = last_us.copy()
    opened = np.empty(len(source), np.int64)
    total = np.zeros((sources + len(source), 9))
    at = np.arange(sources)
    for s in range(sources):
        for k in range(9):
            total[s, k] = sums[s, k]
    count = 0
    for i in range(len(source)):
        s = source[i]
        if bin_us[i] != last_us[s]:
            opened[count] = i
            at[s] = sources + count
            last_us[s] = bin_us[i]
            count += 1
        total[at[s], 0] += 1.0
        for k in range(4):
            value = error[i, k]
            total[at[s], 1 + k] += value * value
            total[at[s], 5 + k] = max(total[at[s], 5 + k], abs(value))
    return opened[:count], last_us, total[: sources + count]
