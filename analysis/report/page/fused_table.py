"""Table of the errors of the fused solutions with and without fault isolation."""

import numpy as np

from analysis.report.curves.fused_curves import AXES, BAND, FUSED, error_ned_m
from analysis.report.curves.recording import FlightData, GroundTrack, Vector
from analysis.report.page.page_parts import ReportTable

NOTE = (
    "Errors against the truth, all epochs. The NEES (squared error over its variance, summed over "
    "three axes) averages 3 if the sigmas are right."
)


def fused_table(recording: FlightData) -> ReportTable | None:
    """One row per fused solution; None without the truth or a fused solution."""
    truth = recording.track("truth")
    tracks = [track for track in recording.tracks if track.name.startswith(FUSED)]
    if truth is None or not tracks:
        return None
    rows = [
        # The sigma curves are those of this solution.
        _row(track, truth, _sigmas(recording) if track.name == FUSED else None)
        for track in tracks
    ]
    head = ("solution", "epochs", "position RMSE, m", "largest, m", "within 3 sigma", "NEES")
    return ReportTable("Fused, with and without isolation", head, rows, NOTE)


def _sigmas(recording: FlightData) -> tuple[Vector, Vector] | None:
    """Times (n,) and sigmas (n, 3) north, east, down of the fused solution."""
    curves = [curve for axis in AXES if (curve := recording.curve("fused-sigma", axis))]
    if len(curves) < len(AXES):
        return None
    return curves[0].t_s, np.column_stack([curve.value for curve in curves])


def _row(
    track: GroundTrack, truth: GroundTrack, sigmas: tuple[Vector, Vector] | None
) -> tuple[str, ...]:
    t_s, error = error_ned_m(track, truth)
    if not len(t_s):
        return (track.name, "0", "", "", "", "")
    length = np.sqrt((error**2).sum(axis=1))
    inside = nees = ""
    if sigmas is not None:
        # Sigmas interpolated to the times of the errors.
        sigma = np.column_stack([np.interp(t_s, sigmas[0], column) for column in sigmas[1].T])
        shares = error / sigma
        # Normally distributed errors with right sigmas give 99.7 %.
        inside = f"{100 * float(np.mean(np.abs(shares) < BAND)):.1f} %"
        nees = f"{float((shares**2).sum(axis=1).mean()):.2f}"
    rmse = float(np.sqrt(np.mean(length**2)))
    return (track.name, str(len(t_s)), f"{rmse:.2f}", f"{length.max():.2f}", inside, nees)
