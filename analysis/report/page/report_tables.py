"""CompiledCore and facts of a report page."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from analysis.report.curves.panels import ATTITUDE, CHECKS, FAULT_EFFECTS, TIMELINE
from analysis.report.curves.recording import FlightData
from analysis.report.judging.checks import FAIL, NONE, PASS, RANK, WARN, FlightCheck
from analysis.report.page.page_parts import Cell, ReportTable, TimeButtons
from analysis.report.recordings.from_results import isolation_matrix
from analysis.results import Result
from analysis.scoring.run_remarks import run_remarks
from mavproxy_fault.wire.label import Label

EFFECTS = {"position_m": "position, m", "speed_mps": "speed, m/s", "attitude_deg": "attitude, °"}
REASONS = 6  # shown under the verdict


def run_facts(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    facts = []
    if "outcome" in summary:
        facts.append(("outcome", summary["outcome"]["outcome"]))
    attitude = summary.get("attitude_rmse_deg")
    rows = summary.get("faults") or []
    hours = (summary.get("sim_s") or 0) / 3600
    false_alarms = summary.get("false_alarms")
    if rows:
        seen = sum(bool(row["detected"]) for row in rows)
        facts.append(("faults detected", f"{seen} of {len(rows)}"))
        delays = [row["delay_s"] for row in rows if row["delay_s"] is not None]
        if delays:
            facts.append(("longest detection delay", f"{max(delays):.2f} s"))
    if false_alarms is not None:
        facts.append(("false alarms", str(false_alarms)))
        if hours > 0:
            facts.append(("false alarms per hour", f"{false_alarms / hours:.1f}"))
    if summary.get("epochs") is not None:
        facts.append(("GNSS epochs", str(summary["epochs"])))
    if summary.get("untestable_epochs") is not None:
        facts.append(("epochs untestable", str(summary["untestable_epochs"])))
    if summary.get("unexplained_epochs"):
        facts.append(("epochs unexplained", str(summary["unexplained_epochs"])))
    if attitude:
        facts.append(("attitude RMSE, worst axis", f"{attitude['max']:.2f}°"))
    if summary.get("position_rmse_m") is not None:
        facts.append(("position RMSE", f"{summary['position_rmse_m']:.2f} m"))
    if summary.get("sim_s"):
        facts.append(("flight", f"{summary['sim_s']:.0f} s"))
    return facts


def run_tables(summary: Mapping[str, Any]) -> list[tuple[str, ReportTable]]:
    tables = []
    rows = summary.get("faults") or []
    if rows:
        head = (
            "fault",
            "target",
            "from, s",
            "to, s",
            "frames",
            "delay, s",
            "isolated",
            "verdict",
            "note",
        )
        cells = [
            (
                str(row["id"]),
                str(row["target"]),
                _short(row["start_s"]),
                _short(row["end_s"]),
                str(row["frames"]),
                _short(row["delay_s"]),
                ", ".join(row["isolated"]),
                (str(row["verdict"]), str(row["verdict"])),
                _remark(row),
            )
            for row in rows
        ]
        tables.append((TIMELINE, ReportTable("Injected against detected", head, cells)))
    false = summary.get("false_by_channel") or []
    if false:
        tables.append((TIMELINE, _false_table(false)))
    remarks = run_remarks(summary) if "untestable_reasons" in summary else []
    if remarks:
        tables.append((CHECKS, ReportTable("Remarks", ("kind", "what"), remarks)))
    effects = summary.get("effects") or []
    if effects:
        tables.append((FAULT_EFFECTS, _effect_table(effects)))
    checks = summary.get("criteria") or []
    if checks:
        texts = {True: "PASS", False: "FAIL", None: "not judged"}
        cells_ = [
            (
                str(check["name"]),
                _shown(check["value"]),
                _shown(check["limit"]),
                (texts[check["passed"]], texts[check["passed"]]),
            )
            for check in checks
        ]
        head_ = ("criterion", "found", "limit", "verdict")
        tables.append((CHECKS, ReportTable("Criteria", head_, cells_)))
    return tables + attitude_tables(summary)


def _remark(row: Mapping[str, Any]) -> str:
    """Reason of the outcome, and false isolations during the fault."""
    wrongly = (
        f"{one['who']} isolated wrongly from {one['from_s']:.1f} s for {one['for_s']:.1f} s"
        for one in row.get("wrongly", ())
    )
    return "; ".join(filter(None, (str(row.get("reason", "")), *wrongly)))


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


def _false_table(rows: Sequence[Mapping[str, Any]]) -> ReportTable:
    head = ("channel", "outside faults", "inside faults", "per hour", "isolated", "for, s")
    cells = [
        (
            str(row["channel"]),
            *(str(row["outside"]), str(row["inside"]), f"{row['per_hour']:g}"),
            *(", ".join(row["blamed"]), f"{row['seconds']:.1f}"),
        )
        for row in rows
    ]
    note = "Alarms that no fault explains; inside a fault only those that isolated a sensor."
    return ReportTable("False alarms", head, cells, note)


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
        "period",
        "samples",
        "roll",
        "pitch",
        "yaw",
        "total",
        "total, 95th percentile",
        "total, largest",
    )
    note = "RMS errors in degrees; the total is the angle of rotation from estimate to truth."
    return ReportTable(f"Attitude errors of {name}", head, rows, note)


def criteria_reasons(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The criteria that a run did not meet."""
    return [
        (FAIL, f"{row['name']}: {_shown(row['value'])}, limit {_shown(row['limit'])}")
        for row in summary.get("criteria") or ()
        if row["passed"] is False
    ]


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else str(value)


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def matrix_table(labels: Sequence[Label], results: Sequence[Result]) -> ReportTable | None:
    """Isolation matrix: decisions by injected fault, shaded by share of the row."""
    heads, counts = isolation_matrix(labels, results)
    if not heads:
        return None
    rows = [(name, *(str(count) if count else "" for count in row)) for name, row in counts.items()]
    note = "GNSS epochs by injected fault (rows) and decision of the detector (columns)."
    return ReportTable("Isolation matrix", ("injected", *heads), rows, note, style="matrix")


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
    bad = [check for check in checks if check.verdict in (WARN, FAIL)]
    bad.sort(key=lambda check: -RANK[check.verdict])
    # Sorted, so that those omitted are never worse than those shown.
    lines = [(check.verdict, f"{check.name}: {check.evidence}") for check in bad[:REASONS]]
    if len(bad) > REASONS:
        lines.append((bad[REASONS].verdict, f"and {len(bad) - REASONS} more, see Checks"))
    return lines


def reaction_table(faults: Sequence[Mapping[str, Any]]) -> ReportTable | None:
    """The autopilot's reactions to each fault; None if they were not searched."""
    rows = [
        (
            str(fault["id"]),
            f"{reaction['t_s']:.2f}",
            f"{reaction['after_s']:.2f}",
            str(reaction["text"]),
        )
        for fault in faults
        for reaction in fault.get("reaction", ())
    ]
    # If reactions were searched and none was found, the table is empty.
    if not any("reaction" in fault for fault in faults):
        return None
    head = ("fault", "t, s", "after, s", "reaction")
    # Limited, so that many messages do not hide the rest of the section.
    return ReportTable("The autopilot's reactions to injected faults", head, rows[:60])


def links_table(recording: FlightData) -> ReportTable:
    """Frames and losses of each sender."""
    rows = [
        (
            link.log,
            f"{link.system}/{link.component}",
            str(link.frames),
            str(link.lost),
            f"{100 * link.lost / (link.frames + link.lost):.2f}",
            f"{link.longest_gap_s:.2f}",
        )
        for link in recording.links
    ]
    head = ("log", "sender", "frames", "missing", "%", "longest gap, s")
    note = "Missing frames are counted by gaps in each sender's sequence numbers (modulo 256)."
    return ReportTable("Senders", head, rows, note)


def _differs(value: float, default: float) -> bool:
    """Whether two float32 values of a log differ."""
    # float32 has seven digits; the two may have been converted differently.
    return abs(value - default) > 1e-6 * max(abs(value), abs(default))


def parameters_table(recording: FlightData) -> list[ReportTable]:
    """Parameters that changed, those not at their default, and all parameters (folded)."""
    changed = [
        (name, f"{t_s:.2f}", f"{before:.7g}", f"{value:.7g}")
        for name, history in recording.parameters.items()
        # The first entry of a history is the initial value.
        for (_, before), (t_s, value) in itertools.pairwise(history)
    ]
    every = [(name, f"{h[-1][1]:.7g}") for name, h in sorted(recording.parameters.items())]
    title = f"All parameters ({len(every)})"
    tables = [ReportTable(title, ("parameter", "value"), every, folded=True)]
    unusual = [
        (name, f"{history[-1][1]:.7g}", f"{recording.defaults[name]:.7g}")
        for name, history in sorted(recording.parameters.items())
        if name in recording.defaults and _differs(history[-1][1], recording.defaults[name])
    ]
    if unusual:
        title = f"Parameters that are not at their default ({len(unusual)})"
        head = ("parameter", "value", "default")
        # Folded if longer than a screen.
        tables.insert(0, ReportTable(title, head, unusual, folded=len(unusual) > 40))
    if changed:
        moves = ("parameter", "t, s", "before", "after")
        tables.insert(0, ReportTable("Parameters changed", moves, changed[:200]))
    return tables
