"""Tables and facts of a report page."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from analysis.report.curves.panels import (
    ATTITUDE,
    CHECKS,
    DETECTION,
    FAULT_EFFECTS,
    FUSION,
    TIMELINE,
)
from analysis.report.curves.recording import FlightData
from analysis.report.judging.checks import FAIL, MET, NONE, PASS, RANK, FlightCheck, worst_first
from analysis.report.page.fused_table import fused_table
from analysis.report.page.page_parts import Cell, ReportTable, TimeButtons
from analysis.report.recordings.from_results import isolation_matrix
from analysis.results import Result
from analysis.scoring.run_remarks import fault_remarks, run_remarks
from mavproxy_fault.wire.label import Label

EFFECTS = {"position_m": "position, m", "speed_mps": "speed, m/s", "attitude_deg": "attitude, °"}
REASONS = 6  # shown under the verdict


# Heads of columns, and the fields of the rows in a summary.
FAULT_COLUMNS = {
    "fault": "id", "target": "target", "from, s": "start_s", "to, s": "end_s", "frames": "frames",
    "delay, s": "delay_s", "isolated": "isolated",
}  # fmt: skip
FALSE_COLUMNS = {
    "channel": "channel", "outside faults": "outside", "inside faults": "inside",
    "per hour": "per_hour", "isolated": "blamed", "for, s": "seconds",
}  # fmt: skip
REACTION_COLUMNS = {"t, s": "t_s", "after, s": "after_s", "reaction": "text"}


def run_facts(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The key figures of a summary that it has."""
    rows, sim_s = summary.get("faults") or [], summary.get("sim_s")
    delays = [row["delay_s"] for row in rows if row["delay_s"] is not None]
    false_alarms, attitude = summary.get("false_alarms"), summary.get("attitude_rmse_deg")
    per_hour = None if false_alarms is None or not sim_s else 3600 * false_alarms / sim_s
    facts = (
        ("outcome", "{}", summary.get("outcome", {}).get("outcome")),
        ("faults detected", f"{{}} of {len(rows)}",
         sum(bool(row["detected"]) for row in rows) if rows else None),
        ("longest detection delay", "{:.2f} s", max(delays, default=None)),
        ("false alarms", "{}", false_alarms),
        ("false alarms per hour", "{:.1f}", per_hour),
        ("GNSS epochs", "{}", summary.get("epochs")),
        ("epochs untestable", "{}", summary.get("untestable_epochs")),
        ("epochs unexplained", "{}", summary.get("unexplained_epochs") or None),
        ("attitude RMSE, worst axis", "{:.2f}°", attitude["max"] if attitude else None),
        ("position RMSE", "{:.2f} m", summary.get("position_rmse_m")),
        ("flight", "{:.0f} s", sim_s or None),
    )  # fmt: skip
    return [(name, form.format(value)) for name, form, value in facts if value is not None]


def run_tables(summary: Mapping[str, Any]) -> list[tuple[str, ReportTable]]:
    """Section and table of the faults, alarms, effects, criteria and scores of a summary."""
    tables = []
    if rows := summary.get("faults"):
        head = (*FAULT_COLUMNS, "verdict", "note")
        cells: list[list[Cell]] = [
            [
                *_cells(row, FAULT_COLUMNS),
                (row["verdict"], row["verdict"]),
                "; ".join(fault_remarks(row)),
            ]
            for row in rows
        ]
        tables.append(
            (TIMELINE, ReportTable("Injected against detected", head, cells, style="cards"))
        )
    if false := summary.get("false_by_channel"):
        note = "Alarms that no fault explains; inside a fault only those that isolated a sensor."
        alarms = [_cells(row, FALSE_COLUMNS) for row in false]
        tables.append((TIMELINE, ReportTable("False alarms", tuple(FALSE_COLUMNS), alarms, note)))
    if remarks := run_remarks(summary) if "untestable_reasons" in summary else []:
        tables.append((CHECKS, ReportTable("Remarks", ("kind", "what"), remarks)))
    if effects := summary.get("effects"):
        tables.append((FAULT_EFFECTS, _effect_table(effects)))
    if checks := summary.get("criteria"):
        judged: list[list[Cell]] = [
            [
                str(row["name"]),
                _limit(row["value"]),
                _limit(row["limit"]),
                (MET[row["passed"]],) * 2,
            ]
            for row in checks
        ]
        limits = ("criterion", "found", "limit", "verdict")
        tables.append((CHECKS, ReportTable("Criteria", limits, judged)))
    return tables + attitude_tables(summary)


def _cells(row: Mapping[str, Any], columns: Mapping[str, str]) -> list[Cell]:
    return [_shown(row[key]) for key in columns.values()]


def _effect_table(rows: Sequence[Mapping[str, Any]]) -> ReportTable:
    """Largest and lasting deviation of truth and estimates caused by each fault."""
    names = dict.fromkeys(name for row in rows for kind in EFFECTS for name in row.get(kind, {}))
    kinds = [
        (key, n) for key in EFFECTS for n in names if any(n in row.get(key, {}) for row in rows)
    ]
    head = ("fault", *(f"{EFFECTS[key]}, {name}: largest / lasting" for key, name in kinds))
    cells = []
    for row in rows:
        extents = [row.get(key, {}).get(name) for key, name in kinds]
        shown = (f"{e['most']:.2f} / {e['lasting']:.2f}" if e else "" for e in extents)
        cells.append((str(row["id"]), *shown))
    note = "Against the fault-free reference flight, from a fault's start until its effects end."
    return ReportTable("Effects of the faults", head, cells, note)


def attitude_tables(summary: Mapping[str, Any]) -> list[tuple[str, ReportTable]]:
    """Scores of each attitude estimator: overall, by phase of flight and by fault."""
    return [
        (ATTITUDE, _attitude_table(name, scores))
        for name, scores in (summary.get("attitude") or {}).items()
    ]


def _attitude_table(name: str, scores: Mapping[str, Any]) -> ReportTable:
    parts = [("entire flight", scores), ("without faults", scores.get("nominal", {}))]
    parts += [(f"phase: {phase}", part) for phase, part in scores.get("phases", {}).items()]
    parts += [(f"fault: {fault}", part) for fault, part in scores.get("faults", {}).items()]
    rows = [
        (
            label,
            str(part["samples"]),
            *(f"{part['rmse_deg'][axis]:.2f}" for axis in ("roll", "pitch", "yaw", "angle")),
            f"{part['angle_percentiles_deg']['95']:.2f}",
            f"{part['max_deg']['angle']:.2f}",
        )
        for label, part in parts
        if part.get("samples")
    ]
    head = (
        "period", "samples", "roll", "pitch", "yaw", "total", "total, 95th percentile",
        "total, largest",
    )  # fmt: skip
    note = "RMS errors in degrees; the total is the angle of rotation from estimate to truth."
    return ReportTable(f"Attitude errors of {name}", head, rows, note)


def criteria_reasons(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The criteria that a run did not meet."""
    return [
        (FAIL, f"{row['name']}: {_limit(row['value'])}, limit {_limit(row['limit'])}")
        for row in summary.get("criteria") or ()
        if row["passed"] is False
    ]


def _limit(value: object) -> str:
    """Format a number with the digits of a limit."""
    return f"{value:.4g}" if isinstance(value, float) else _shown(value)


def _shown(value: object) -> str:
    """Format a value of a result: a time with hundredths, a list as words."""
    if isinstance(value, float):
        return f"{value:.2f}"
    return (
        "" if value is None else ", ".join(value) if isinstance(value, list | tuple) else str(value)
    )


def result_tables(
    labels: Sequence[Label], results: Sequence[Result], recording: FlightData
) -> list[tuple[str, ReportTable]]:
    """Tables of the monitor's isolations and of the fused solutions, as far as there are any."""
    found = []
    heads, counts = isolation_matrix(labels, results)
    if heads:
        rows = [(name, *(str(count or "") for count in row)) for name, row in counts.items()]
        note = "GNSS epochs by injected fault (rows) and decision of the detector (columns)."
        # Shaded by the share of the row.
        matrix = ReportTable("Isolation matrix", ("injected", *heads), rows, note, style="matrix")
        found.append((DETECTION, matrix))
    fused = fused_table(recording)
    return found if fused is None else [*found, (FUSION, fused)]


def checks_tables(checks: Sequence[FlightCheck]) -> list[ReportTable]:
    """Failed checks first, then passed and not judged ones, folded."""
    head = ("verdict", "check", "found", "limit", "when")
    rows: dict[str, list[Sequence[Cell]]] = {}
    for check in sorted(checks, key=lambda check: -RANK[check.verdict]):
        # Failed and warning checks share the table that is open.
        group = check.verdict if check.verdict in (PASS, NONE) else ""
        cells = ((check.verdict, check.verdict), check.name, check.evidence, check.limit)
        rows.setdefault(group, []).append((*cells, TimeButtons(check.windows, check.panel)))
    titles = {"": "Not passed", PASS: "Passed ({})", NONE: "Not judged ({})"}
    return [
        ReportTable(titles[group].format(len(some)), head, some, folded=group != "", style="cards")
        for group, some in rows.items()
    ]


def check_reasons(checks: Sequence[FlightCheck]) -> list[tuple[str, str]]:
    """Warnings and failures that determine the verdict, the worst first."""
    bad = worst_first(checks)
    # Sorted, so that those omitted are never worse than those shown.
    lines = [(check.verdict, f"{check.name}: {check.evidence}") for check in bad[:REASONS]]
    if len(bad) > REASONS:
        lines.append((bad[REASONS].verdict, f"and {len(bad) - REASONS} more, see Checks"))
    return lines


def reaction_table(faults: Sequence[Mapping[str, Any]]) -> ReportTable | None:
    """The autopilot's reactions to each fault; None if they were not searched."""
    rows = [
        [str(fault["id"]), *_cells(reaction, REACTION_COLUMNS)]
        for fault in faults
        for reaction in fault.get("reaction", ())
    ]
    # If reactions were searched and none was found, the table is empty.
    if not any("reaction" in fault for fault in faults):
        return None
    # Limited, so that many messages do not hide the rest of the section.
    title = "The autopilot's reactions to injected faults"
    return ReportTable(title, ("fault", *REACTION_COLUMNS), rows[:60])


def links_table(recording: FlightData) -> ReportTable:
    """Frames and losses of each sender."""
    rows = [
        (
            link.log, f"{link.system}/{link.component}", str(link.frames), str(link.lost),
            f"{100 * link.lost / (link.frames + link.lost):.2f}", f"{link.longest_gap_s:.2f}",
        )
        for link in recording.links
    ]  # fmt: skip
    head = ("log", "sender", "frames", "missing", "%", "longest gap, s")
    note = "Missing frames are counted by gaps in each sender's sequence numbers (modulo 256)."
    return ReportTable("Senders", head, rows, note)


def _differs(value: float, default: float) -> bool:
    """Whether two float32 values of a log differ."""
    # float32 has seven digits; the two may have been converted differently.
    return abs(value - default) > 1e-6 * max(abs(value), abs(default))


def parameters_table(recording: FlightData) -> list[ReportTable]:
    """Parameters that changed, those not at their default, and all parameters (folded)."""
    tables, last = [], {n: h[-1][1] for n, h in sorted(recording.parameters.items())}
    changed = [
        (name, f"{t_s:.2f}", f"{before:.7g}", f"{value:.7g}")
        for name, history in recording.parameters.items()
        # The first entry of a history is the initial value.
        for (_, before), (t_s, value) in itertools.pairwise(history)
    ]
    if changed:
        moves = ("parameter", "t, s", "before", "after")
        tables.append(ReportTable("Parameters changed", moves, changed[:200]))
    defaults = recording.defaults
    unusual = [
        (name, f"{value:.7g}", f"{defaults[name]:.7g}")
        for name, value in last.items()
        if name in defaults and _differs(value, defaults[name])
    ]
    if unusual:
        title = f"Parameters that are not at their default ({len(unusual)})"
        head = ("parameter", "value", "default")
        # Folded if longer than a screen.
        tables.append(ReportTable(title, head, unusual, folded=len(unusual) > 40))
    every = [(name, f"{value:.7g}") for name, value in last.items()]
    title = f"All parameters ({len(every)})"
    return [*tables, ReportTable(title, ("parameter", "value"), every, folded=True)]
