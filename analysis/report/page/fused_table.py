"""Fused with and without isolation side by side, in numbers."""

import numpy as np

from analysis.report.curves.fused_curves import AXES, BAND, FUSED, error_ned_m
from analysis.report.page.page_parts import ReportTable
from analysis.report.recordings.recording import FlightData, GroundTrack, Vector

NOTE = (
    "Against the truth, all epochs. The squared error over its own variance, summed over three "
    "axes, is 3 on average where the sigmas are right."
)


def fused_table(recording: FlightData) -> ReportTable | None:
    """One row per fused solution; None without any or without the truth."""
    truth = next((track for track in recording.tracks if track.name == "truth"), None)
    tracks = [track for track in recording.tracks if track.name.startswith(FUSED)]
    if truth is None or not tracks:
        # Without truth there is no error to put in numbers; without fused tracks nothing to
        # compare.
        return None
    rows = [
        # The curves of sigmas belong to this solution only.
        _row(track, truth, _sigmas(recording) if track.name == FUSED else None)
        for track in tracks
    ]
    head = ("solution", "epochs", "position RMSE, m", "largest, m", "within 3 sigma", "NEES")
    return ReportTable("Fused, with and without isolation", head, rows, NOTE)


def _sigmas(recording: FlightData) -> tuple[Vector, Vector] | None:
    """Times (n,) and sigmas (n, 3) of the fused solution."""
    curves = {signal.name: signal for signal in recording.of("fused-sigma")}
    if any(axis not in curves for axis in AXES):
        return None
    return curves["north"].t_s, np.column_stack([curves[axis].value for axis in AXES])


def _row(
    track: GroundTrack, truth: GroundTrack, sigmas: tuple[Vector, Vector] | None
) -> tuple[str, ...]:
    t_s, error = error_ned_m(track, truth)
    if not len(t_s):
        return (track.name, "0", "", "", "", "")
    length = np.sqrt((error**2).sum(axis=1))
    inside = nees = ""
    if sigmas is not None:
        # Sigmas at the error's times: the two need not share their epochs.
        sigma = np.column_stack([np.interp(t_s, sigmas[0], column) for column in sigmas[1].T])
        shares = error / sigma
        # Right sigmas of a normal error give 99.7 %.
        inside = f"{100 * float(np.mean(np.abs(shares) < BAND)):.1f} %"
        nees = f"{float((shares**2).sum(axis=1).mean()):.2f}"
    rmse = float(np.sqrt(np.mean(length**2)))
    return (track.name, str(len(t_s)), f"{rmse:.2f}", f"{length.max():.2f}", inside, nees)
