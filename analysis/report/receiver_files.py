"""Write positions and tracks of a receiver recording, and collect pictures for its report."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from analysis.recordings.position_reference import PositionReference
from analysis.report.curves.recording import FlightData, GroundTrack
from analysis.report.page.gnss_figures import gnss_pictures
from analysis.report.recordings.from_results import axis_start, recording_of_results
from analysis.report.solution_files import write_solution
from analysis.results import Decision, Result
from analysis.scoring.integrity import Integrity
from analysis.scoring.position_scores import HORIZONTAL, VERTICAL, PositionScores
from mavproxy_fault.numerics.earth import geodetic_from_ecef
from mavproxy_fault.wire.label import Label


def receiver_files(
    folder: Path,
    results: Sequence[Result],
    labels: Sequence[Label],
    reference: PositionReference | None,
    integrity: Integrity,
    scores: PositionScores,
) -> dict[str, Any]:
    """Write positions and tracks to the folder; returns tracks and pictures for the report.

    `scores` are the errors against the `reference`.
    """
    t0_us = axis_start(labels, results) or 0
    recording = recording_of_results(labels, results, t0_us)
    truth = [] if reference is None else _truth(results, reference, t0_us)
    recording.tracks.extend(truth)
    write_solution(folder, results, recording)
    assumed = f", while {' or '.join(integrity.assumed)}"
    tables = {name: integrity.table(name) for name in integrity.pairs}
    levels = {name + assumed: table for name, table in tables.items() if len(table)}
    errors = {name: scores.table(name)[:, [HORIZONTAL, VERTICAL]] for name in scores.solutions()}
    pictures = gnss_pictures(results, errors, levels)
    return {"beside": FlightData("", tracks=truth), "pictures": pictures}


def _truth(
    results: Sequence[Result], reference: PositionReference, t0_us: int
) -> list[GroundTrack]:
    """The position reference at the epochs, as a track."""
    stamps = [result.t_us for result in results if isinstance(result, Decision)]
    known = [(t_us, place) for t_us in stamps if (place := reference.at(t_us)) is not None]
    if len(known) < 2:
        return []
    lat, lon, height = geodetic_from_ecef(np.array([place for _, place in known]))
    t_s = (np.array([t_us for t_us, _ in known]) - t0_us) * 1e-6
    return [GroundTrack("truth", t_s, np.degrees(lat), np.degrees(lon), height)]
