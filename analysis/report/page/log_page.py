"""Compose the report page of a log: verdict, checks, injected faults and tables."""

from collections.abc import Sequence
from datetime import UTC, datetime

from analysis.report.curves.panels import CHECKS, GPS, LINK, TIMELINE
from analysis.report.flight_verdict import FlightAssessment
from analysis.report.judging.checks import FAIL, PASS, WARN, FlightCheck, chain_text
from analysis.report.judging.flight_facts import flight_facts
from analysis.report.page.log_sky import sky_pictures
from analysis.report.page.page_parts import SENSOR_LIMIT, LimitLine, ReportPage, ReportTable
from analysis.report.page.report_tables import (
    check_reasons,
    checks_tables,
    links_table,
    parameters_table,
    reaction_table,
    result_tables,
    run_facts,
    run_tables,
)

LATEST_UTC_US = 1 << 52  # the year 2112
# Names as spelled by the projects.
AUTOPILOTS = {"px4": "PX4", "ardupilot": "ArduPilot"}
# Facts that need monitor results; without, they would all be zero.
NEEDS_RESULTS = {"flight", "GNSS epochs", "epochs untestable", "false alarms"}
# Panels whose curve is the value that the check judges; only these show its limits.
DIRECT = {
    "vibration", "gps-satellites", "gps-fix", "gps-dilution", "gps-jump", "ratio", "variance",
    "estimate-jump", "battery-remaining", "board-voltage", "position-error",
}  # fmt: skip


def log_page(outcome: FlightAssessment, tables: Sequence[tuple[str, ReportTable]]) -> ReportPage:
    """Build the page of a log: checks, reactions to injected faults, links and parameters."""
    flight, recording = outcome.flight, outcome.flight.recording
    summary = outcome.summary
    every = run_tables({"faults": summary["faults"], "attitude": flight.summary.get("attitude")})
    every += [(CHECKS, table) for table in checks_tables(outcome.checks)]
    reaction = reaction_table(summary["faults"])
    if reaction is not None:
        every.append((TIMELINE, reaction))
    every += [*result_tables(flight.labels, flight.results, recording), *tables]
    if recording.links:
        every.append((LINK, links_table(recording)))
    if recording.parameters:
        every += [("Parameters", table) for table in parameters_table(recording)]
    shown = [("outcome", str(summary["outcome"]["outcome"]))]
    shown += [("flight", f"{recording.duration_s:.0f} s"), *_counts(outcome.checks)]
    kind = recording.vehicle or AUTOPILOTS.get(recording.autopilot, "")
    known = {"vehicle": kind, **recording.identity, "date": _date(recording.utc0_us)}
    shown += [(name, text) for name, text in known.items() if text]
    if order := chain_text(outcome.checks):
        shown.append(("findings in order", order))
    shown += flight_facts(recording) + _run_facts(outcome)
    return ReportPage(
        recording.name,
        outcome.verdict,
        shown,
        every,
        {**SENSOR_LIMIT, **panel_limits(outcome.checks)},
        check_reasons(outcome.checks),
        [(GPS, *picture) for picture in sky_pictures(recording)],
    )


def _date(utc_us: int) -> str:
    """The date and time at which the log begins; empty if unknown."""
    if not 0 < utc_us < LATEST_UTC_US:
        return ""
    return datetime.fromtimestamp(utc_us * 1e-6, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _counts(checks: Sequence[FlightCheck]) -> list[tuple[str, str]]:
    titles = ((PASS, "checks passed"), (WARN, "warnings"), (FAIL, "checks failed"))
    counts = [(text, sum(check.verdict == word for check in checks)) for word, text in titles]
    return [(text, str(count)) for text, count in counts]


def _run_facts(outcome: FlightAssessment) -> list[tuple[str, str]]:
    """Facts of a run's summary; epoch counts only with monitor results."""
    hidden = {"flight"} if outcome.flight.results else NEEDS_RESULTS
    return [fact for fact in run_facts(outcome.summary) if fact[0] not in hidden | {"outcome"}]


def panel_limits(checks: Sequence[FlightCheck]) -> dict[str, list[LimitLine]]:
    """Limit lines of each check, for plots of the value that the check judges."""
    return {
        check.panel: [
            LimitLine(check.levels[0], "warn", "warn"),
            LimitLine(check.levels[1], "fail", "fail"),
        ]
        for check in checks
        if check.levels is not None and check.panel in DIRECT
    }
