"""Table of the errors of the fused solutions with and without fault isolation."""

import numpy as np

from analysis.report.curves.fused_curves import AXES, BAND, FUSED, solution_errors
from analysis.report.curves.recording import FlightData, Vector
from analysis.report.page.page_parts import ReportTable

NOTE = (
    "Errors against the truth, all epochs. The NEES (squared error over its variance, summed over "
    "three axes) averages 3 if the sigmas are right."
)


def fused_table(recording: FlightData) -> ReportTable | None:
    """One row per fused solution; None without the truth or a fused solution."""
    # The sigma curves are those of this solution.
    rows = [
        _row(name, t_s, error, _sigmas(recording) if name == FUSED else None)
        for name, t_s, error in solution_errors(recording)
    ]
    if not rows:
        return None
    head = ("solution", "epochs", "position RMSE, m", "largest, m", "within 3 sigma", "NEES")
    return ReportTable("Fused, with and without isolation", head, rows, NOTE)


def _sigmas(recording: FlightData) -> tuple[Vector, Vector] | None:
    """Times (n,) and sigmas (n, 3) north, east, down of the fused solution."""
    curves = [curve for axis in AXES if (curve := recording.curve("fused-sigma", axis))]
    if len(curves) < len(AXES):
        return None
    return curves[0].t_s, np.column_stack([curve.value for curve in curves])


def _row(
    name: str, t_s: Vector, error: Vector, sigmas: tuple[Vector, Vector] | None
) -> tuple[str, ...]:
    if not len(t_s):
        return (name, "0", "", "", "", "")
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
    return (name, str(len(t_s)), f"{rmse:.2f}", f"{length.max():.2f}", inside, nees)
