"""The evidence folder of a campaign: failure modes and effects (FMEA), and requirements.

    evidence.html     both tables, with inputs and versions, to print or to save as PDF
    fmea.csv          a row for each subject, fault and magnitude
    requirements.csv  a row for each subject and requirement
    campaign.yaml, rows/NAME.yaml   campaign files that make all numbers, or those of a row, again

Bounds are those of `share_bounds` for the share of failed flights. A hash covers all results of a
row except the time they took, and under an autopilot except measured numbers.
"""

import hashlib
import os
import shlex
from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path
from statistics import median

import msgspec

from analysis.campaign.campaign_file import CampaignFile, FaultChoice
from analysis.campaign.cell import CellResult, file_key
from analysis.campaign.magnitude_unit import magnitude_units
from analysis.campaign.outcomes import ABORTED
from analysis.campaign.results.campaign_report import write_csv
from analysis.campaign.results.outcome_grid import GridCell, GridRow, outcome_grid
from analysis.campaign.results.subject_scores import share_bounds
from analysis.campaign.results_store import read_campaign_folder
from analysis.report.page.page_body import read_asset, table_html
from analysis.report.page.page_file import html_document
from analysis.report.page.page_parts import ReportTable
from mavproxy_fault import __version__
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import without_none, write_yaml
from mavproxy_fault.faults.registry import fault_class
from mavproxy_fault.schedule.presets import read_preset

# A page of paper takes all columns: hashes and commands wrap. A screen scrolls: they wrap less.
STYLE = (
    "@page { size: landscape; } .wide td:nth-last-child(-n+2) { overflow-wrap: anywhere; } "
    "@media screen { .wide td:nth-last-child(-n+2) { min-width: 22ch; } }"
)
TITLES = ("Inputs", "Failure modes and effects", "Requirements")
Row = dict[str, str]


def write_evidence(folder: Path, out: Path) -> None:
    """Write the evidence of a completed campaign.

    Raises
    ------
    ConfigError
        If a campaign file cannot repeat its rows.
    """
    campaign, results = read_campaign_folder(folder)
    if campaign.compiled or campaign.cover != "all":
        raise ConfigError("--evidence: needs scenario files, and all pairs if any (cover: all)")
    (out / "rows").mkdir(parents=True, exist_ok=True)
    (out / "campaign.yaml").write_text(campaign_text(campaign, out))
    grid = outcome_grid(results, campaign)
    tables = {
        "fmea": [fmea_row(campaign, row, cell, out) for row in grid for cell in row.cells],
        "requirements": requirement_rows(campaign, results),
    }
    for name, rows in tables.items():
        write_csv(out / f"{name}.csv", rows)
    (out / "evidence.html").write_text(render_page(campaign, tables), encoding="utf-8")


def fmea_row(campaign: CampaignFile, row: GridRow, cell: GridCell, out: Path) -> Row:
    """Return the row of a subject, a fault and a magnitude, and write its campaign file."""
    fault = campaign.all_faults[row.fault]
    size = magnitude_units(campaign)[row.fault].describe(cell.magnitude)
    flown = [one for one in cell.results if one.outcome != ABORTED]
    outcomes = Counter(one.outcome for one in flown)
    detected = [one for one in flown if one.detected_s is not None]
    delays_s = [one.detected_s for one in detected if one.detected_s is not None]
    failsafes = Counter(one.failsafe for one in flown if one.failsafe)
    sized = fault if cell.magnitude is None else replace_magnitude(fault, cell.magnitude)
    file = out / "rows" / f"{file_key(row.subject, row.fault, size)}.yaml"
    file.write_text(campaign_text(campaign, file.parent, row.subject, sized))
    return {
        "subject": row.subject,
        "failure mode": f"{row.fault} {size}".rstrip(),
        "local effect": describe_fault(fault),
        "effect on the vehicle": _counts(outcomes),
        "detection": _counts(Counter(one.detected_by for one in detected)) or "none",
        "detection delay, s": f"{median(delays_s):.2f}" if delays_s else "",
        "mitigation": _counts(failsafes) or "none",
        "severity": campaign.severity.get(cell.worst.outcome, cell.worst.outcome),
        **_failure_bounds(sum(campaign.fails(one) for one in flown), len(flown)),
        **_provenance(campaign, cell.results, str(file.relative_to(out))),
    }


def requirement_rows(campaign: CampaignFile, results: Sequence[CellResult]) -> list[Row]:
    """Return a row for each subject and requirement."""
    names = dict.fromkeys((r.cell.subject, one.name) for r in results for one in r.requirements)
    rows = []
    for subject, name in names:
        own = [result for result in results if result.cell.subject == subject]
        judged = [(one, r) for r in own for one in r.requirements if one.name == name]
        worst, where = min(judged, key=lambda pair: pair[0].fitness)
        shown = [one for one, _ in judged if one.met is not None]
        rows.append(
            {
                "subject": subject,
                "requirement": name,
                "formula": worst.formula,
                "worst": worst.describe(),
                "in cell": where.cell.key,
                **_failure_bounds(sum(not one.met for one in shown), len(shown)),
                **_provenance(campaign, own, "campaign.yaml"),
            }
        )
    return rows


def describe_fault(fault: FaultChoice) -> str:
    """Describe what a fault does to its target, by the documentation of its kind."""
    if fault.faults:
        return " ".join(map(describe_fault, fault.faults))
    target = fault.target if isinstance(fault.target, str) else ", ".join(fault.target or [])
    kind = fault_class(fault.fault) if fault.fault else None
    about = read_preset(fault.preset)["about"] if fault.preset else ""
    what = (kind.__doc__ or "").splitlines()[0] if kind else about
    return f"{target}: {what}" if target else what


def replace_magnitude(fault: FaultChoice, magnitude: float) -> FaultChoice:
    """Return a fault with one magnitude, under the same name."""
    return msgspec.structs.replace(fault, id=fault.name, magnitudes=(magnitude,))


def campaign_text(
    campaign: CampaignFile,
    folder: Path,
    subject: str | None = None,
    fault: FaultChoice | None = None,
) -> str:
    """Return a campaign file for a folder: the campaign, or its flights of a subject and fault."""

    def moved(path: str) -> str:
        return os.path.relpath(Path(campaign.folder) / path, folder)

    subjects = [
        one
        if isinstance(one, str)
        else msgspec.structs.replace(one, parameters=one.parameters and moved(one.parameters))
        for one in campaign.subjects
    ]
    changed = msgspec.structs.replace(
        campaign,
        subjects=tuple(s for s, n in zip(subjects, campaign.subject_names, strict=True)
                       if subject in (None, n)),
        scenarios=tuple(moved(str(scenario)) for scenario in campaign.scenarios),
    )  # fmt: skip
    if fault is not None:
        limits = msgspec.structs.replace(campaign.limits, fail_from=campaign.fail_from)
        changed = msgspec.structs.replace(
            changed, faults=(fault,), combine=None, find="outcomes", limits=limits
        )
    document = without_none(msgspec.to_builtins(changed))
    del document["folder"]
    return write_yaml(document)


def render_page(campaign: CampaignFile, tables: dict[str, list[Row]]) -> str:
    """Return the page: inputs with their hashes, then both tables."""
    inputs = [(f"mavproxy-fault {__version__}", "")]
    paths = [campaign.scenario_arguments(name)[0] for name in campaign.scenario_names]
    paths += [s.binary for s in campaign.subjects if not isinstance(s, str)]
    inputs += [(path, file_hash(path)) for path in dict.fromkeys(paths)]
    tables = {"Inputs": [{"input": name, "sha256": digest} for name, digest in inputs], **tables}
    parts = []
    for title, rows in zip(TITLES, tables.values(), strict=True):
        if rows:
            table = ReportTable(title, list(rows[0]), [list(row.values()) for row in rows])
            parts.append(f"<h2>{title}</h2>{table_html(table)}")
    name = f"Evidence: {campaign.name}"
    body = (
        f"<header><h1>{escape(name)}</h1></header><main>"
        "<p>Bounds: share of failed flights, 95 % confidence (Clopper and Pearson), for the "
        "conditions flown here. A hash covers the results of a row except the time they took, and "
        "under an autopilot except measured numbers; the command makes them again, in this folder."
        "</p>" + "".join(parts) + "</main>"
    )
    return html_document(name, read_asset("page.css") + STYLE, body, "")


def file_hash(path: str) -> str:
    """Return the SHA-256 of a file; empty for a program that is only in the PATH."""
    file = Path(path)
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""


def _failure_bounds(failed: int, flights: int) -> Row:
    low, high = (f"{share:.4f}" for share in share_bounds(failed, flights))
    return {"flights": str(flights), "failed": str(failed), "at least": low, "at most": high}


def _provenance(campaign: CampaignFile, results: Sequence[CellResult], file: str) -> Row:
    """The hash of results, and the command that makes them again."""
    lines = sorted(msgspec.json.encode(repeatable_part(campaign, result)) for result in results)
    command = ["mavproxy-fault", "campaign", file, "--evidence", "again"]
    return {
        "sha256": hashlib.sha256(b"\n".join(lines)).hexdigest(),
        "command": shlex.join(command),
    }


def repeatable_part(campaign: CampaignFile, result: CellResult) -> dict[str, object]:
    """What must be equal in a repeated flight: all but the wall time and the scenario's folder;
    under an autopilot also without measured numbers, which its own clock and link vary."""
    fields = {**msgspec.structs.asdict(result), "wall_s": 0.0}
    if campaign.autopilot(result.cell.subject) is not None:
        fields = {key: value for key, value in fields.items() if not isinstance(value, float)}
        fields["requirements"] = [(one.formula, one.met) for one in result.requirements]
    scenario = result.cell.scenario.rpartition("/")[2]
    return {**fields, "cell": msgspec.structs.replace(result.cell, scenario=scenario)}


def _counts(counts: Counter[str]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.most_common())
