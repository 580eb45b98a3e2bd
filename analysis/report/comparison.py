"""Compare flights: their curves in one plot, checks and parameters side by side in tables."""

from collections.abc import Sequence
from dataclasses import replace

from analysis.report.curves.panels import CHECKS
from analysis.report.curves.recording import FlightData, Signal
from analysis.report.curves.vehicle_phase import armed_windows
from analysis.report.flight_verdict import FlightAssessment
from analysis.report.judging.checks import NONE, FlightCheck
from analysis.report.page.page_parts import ReportTable

# Chosen: two autopilots may differ in a thousand parameters.
ROWS_SHOWN = 300


def overlay_flights(outcome: FlightAssessment, others: Sequence[FlightAssessment]) -> FlightData:
    """Add the curves of the other flights to the recording, aligned in time.

    Flights are aligned at their first arming or, if unknown in one, at their beginning.
    """
    recording = outcome.flight.recording
    signals = list(recording.signals)
    notes = list(recording.notes)
    tracks = list(recording.tracks)
    # Only panels of the first flight, as others have nothing to compare.
    panels = {signal.panel for signal in recording.signals}
    for compared in others:
        theirs = compared.flight.recording
        shift_s, why = _shift(recording, theirs)
        name = theirs.name
        signals += [
            Signal(s.panel, f"{s.name} · {name}", s.t_s + shift_s, s.value)
            for s in theirs.signals
            if s.panel in panels
        ]
        tracks += [
            t._replace(name=f"{t.name} · {name}", t_s=t.t_s + shift_s) for t in theirs.tracks
        ]
        notes.append(f"compared with {name}, shifted by {shift_s:+.2f} s ({why})")
    return replace(recording, signals=signals, tracks=tracks, notes=notes)


def _shift(recording: FlightData, compared: FlightData) -> tuple[float, str]:
    armed, theirs = armed_windows(recording), armed_windows(compared)
    # Both or neither: arming and the start of a log are not a common time.
    if armed and theirs:
        return armed[0][0] - theirs[0][0], "aligned at arming"
    return 0.0, "aligned at the start"


def comparison_tables(
    outcome: FlightAssessment, others: Sequence[FlightAssessment]
) -> list[tuple[str, ReportTable]]:
    """Tables of the verdicts of every check and of the parameters that differ."""
    every = [outcome, *others]
    names = [one.flight.recording.name for one in every]
    tables = [(CHECKS, _checks(every, names))]
    histories = [one.flight.recording.parameters for one in every]
    # `all`: with a log without parameters every parameter would differ.
    if all(histories):
        keys = sorted(set().union(*histories))
        rows = []
        for key in keys:
            values = [_last(history.get(key)) for history in histories]
            # Compared as text of seven digits, the precision of float32.
            if len(set(values)) > 1:
                rows.append((key, *values))
        note = f"{len(rows)} of {len(keys)} parameters differ."
        if len(rows) > ROWS_SHOWN:
            note += f" The first {ROWS_SHOWN} are shown."
        table = ReportTable(
            "Parameters that differ", ("parameter", *names), rows[:ROWS_SHOWN], note, True
        )
        tables.append(("Parameters", table))
    return tables


def _last(history: list[tuple[float, float]] | None) -> str:
    return "not in the log" if not history else f"{history[-1][1]:.7g}"


def _checks(every: Sequence[FlightAssessment], names: Sequence[str]) -> ReportTable:
    by_name: list[dict[str, FlightCheck]] = [
        {check.name: check for check in one.checks} for one in every
    ]
    rows = []
    for name in dict.fromkeys(name for checks in by_name for name in checks):
        found = [checks.get(name) for checks in by_name]
        # Omit checks that were judged in no flight.
        if all(check is None or check.verdict == NONE for check in found):
            continue
        cells: list[str | tuple[str, str]] = [
            ("–", "NONE")
            if check is None
            else (f"{check.verdict}: {check.evidence}", check.verdict)
            for check in found
        ]
        rows.append((name, *cells))
    return ReportTable("Checks side by side", ("check", *names), rows)
