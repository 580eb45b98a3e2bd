"""Recognizes a receiver that jumps back from a slow drift, which no test has shown.

Position less integrated velocity, d, is constant but for noise while both are healthy. The receiver
is back if d is again what it was some time ago, while d before the jump was not (docs/fdi.md, "Back
from a drift").
"""

import numpy as np

from analysis.detection.receiver.carry_off_windows import NATURAL_MPS
from analysis.detection.receiver.position_test import FixMeasurement
from analysis.detection.receiver.receiver_state import DriftTrack, LastFix
from analysis.detection.statistics.chi_square import chi_square_threshold

MARK_US, MARK_COUNT = 5_000_000, 12  # means of 25 fixes at 5 Hz: a fifth of the noise; a minute
NATURAL_S = 1.0  # correlation of a healthy velocity's slow errors: a receiver's own filter
HEALTHY_P = 1e-3  # what returned leaves the bound once in a thousand epochs while healthy
LEAST_LEAD = 9.0  # of chi-square: 3 sigma of one parameter


def follow_drift(
    track: DriftTrack, last: LastFix | None, fix: FixMeasurement, t_us: int
) -> DriftTrack:
    """The track with one more fix; it begins anew where a velocity is unknown."""
    if last is None or fix.v_ned_mps is None or not np.isfinite(last.v_ned_mps).all():
        return DriftTrack()
    velocity_mps = (fix.v_ned_mps + last.v_ned_mps) / 2.0
    if not np.isfinite(velocity_mps).all():
        return DriftTrack()
    moved_m = fix.axes @ (fix.r_ecef_m - last.r_ecef_m)
    d_m = track.d_m + moved_m - velocity_mps * (t_us - last.t_us) * 1e-6
    count = track.fixes + 1
    track = track._replace(d_m=d_m, fixes=count, mean_m=track.mean_m + (d_m - track.mean_m) / count)
    if track.begun_us == 0 or t_us - track.begun_us < MARK_US:
        return track._replace(begun_us=track.begun_us or t_us)
    marks = ((track.begun_us, track.mean_m), *track.marks[: MARK_COUNT - 1])
    return DriftTrack(d_m, marks, t_us)


def has_returned(before: DriftTrack, now: DriftTrack, fix: FixMeasurement, t_us: int) -> bool:
    """Whether the newest fix is back from a drift."""
    healthy = chi_square_threshold(3, HEALTHY_P)
    for mark_us, mean_m in before.marks:
        walked_m2 = NATURAL_MPS**2 * 2.0 * NATURAL_S * (t_us - mark_us) * 1e-6
        variance = fix.variance_m2 + walked_m2
        q, q_before = (
            float(((d_m - mean_m) ** 2 / variance).sum()) for d_m in (now.d_m, before.d_m)
        )
        if q <= healthy and q_before > q + LEAST_LEAD:
            return True
    return False
