"""Write the files of a campaign: HTML page, JSON, CSV and JUnit."""

import csv
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import msgspec

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.cell import CellResult
from analysis.campaign.magnitude_unit import magnitude_units
from analysis.campaign.outcomes import ABORTED
from analysis.campaign.results.campaign_page import render_campaign_page
from analysis.campaign.results.outcome_grid import (
    find_interactions,
    requirement_counts,
    severity_key,
)
from analysis.campaign.results.outcome_table import render_markdown
from analysis.campaign.results.subject_scores import conditions_hash, score_subjects
from analysis.campaign.results_store import (
    BASELINE,
    CURVES,
    REFERENCE_FLIGHTS,
    CellEvidence,
    ReferenceFlightRecord,
    read_campaign_folder,
    read_lines,
)
from mavproxy_fault.documents.atomic_file import write_atomic

MAX_CURVES = 300  # flights with curves in the page, the worst ones


def write_report(folder: Path, plan: CampaignPlan) -> dict[str, object]:
    """Write the page, `campaign-summary.json` (returned), baseline, CSV, Markdown and JUnit XML."""
    campaign, results = write_page(folder, plan)
    summary = campaign_summary(plan, results)
    (folder / "campaign-summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    (folder / "summary.md").write_text(render_markdown(campaign, results), encoding="utf-8")
    write_csv(folder / "cells.csv", [flatten_result(result) for result in results])
    write_baseline(folder / BASELINE, results)
    # A compiled campaign has too many cells for JUnit readers.
    if not campaign.compiled:
        write_junit(folder / "junit.xml", campaign, results)
    return summary


def write_baseline(path: Path, results: list[CellResult]) -> None:
    """Write what `campaign compare` needs of each cell, one cell per line."""
    keys = ("cell", "outcome", "excursion_deg", "excursion_m")
    rows = [msgspec.json.encode({key: getattr(result, key) for key in keys}) for result in results]
    path.write_bytes(b"[\n" + b",\n".join(sorted(rows)) + b"\n]\n")


def write_page(
    folder: Path, plan: CampaignPlan, reload_s: float | None = None
) -> tuple[CampaignFile, list[CellResult]]:
    """Write `campaign.html`, which reloads itself every `reload_s`; return campaign and results."""
    campaign, results = read_campaign_folder(folder)
    # Curves are large, so the page has those of the worst flights only.
    shown = {r.cell.key for r in sorted(results, key=severity_key, reverse=True)[:MAX_CURVES]}
    curves = [item for item in read_lines(folder / CURVES, CellEvidence) if item.key in shown]
    references = {
        # The page needs subject, scenario and seed as key; the results store has one per flight.
        f"{subject}|{key.partition('|')[2]}": evidence
        for key, flight in (
            (record.key, record.flown)
            for record in read_lines(folder / REFERENCE_FLIGHTS, ReferenceFlightRecord)
        )
        for subject, evidence in flight.evidence.items()
    }
    text = render_campaign_page(plan, results, curves, references, reload_s)
    # Replaced as one, since a browser may load it at any time.
    write_atomic(folder / "campaign.html", text)
    return campaign, results


def campaign_summary(plan: CampaignPlan, results: list[CellResult]) -> dict[str, object]:
    """Return outcome counts by subject and fault, and the critical magnitudes if searched."""
    summary: dict[str, object] = {"name": plan.campaign.name, "cells": len(results)}
    summary["failed"] = sum(plan.campaign.fails(result) for result in results)
    counts: dict[str, dict[str, Counter[str]]] = {}
    for result in results:
        by_fault = counts.setdefault(result.cell.subject, {})
        by_fault.setdefault(result.cell.fault, Counter())[result.outcome] += 1
    summary["outcomes"] = counts
    scores = score_subjects(plan.campaign, results)
    summary["scores"] = [msgspec.to_builtins(score) for score in scores]
    summary["conditions_sha256"] = conditions_hash(plan.campaign)
    summary["requirements"] = requirement_counts(results)
    summary["pairs"] = [result.cell.key for result in find_interactions(plan.campaign, results)]
    if plan.campaign.find == "critical":
        known = {result.cell.key: result for result in results}
        summary["critical"] = [
            {"series": series, **critical._asdict()}
            for series, critical in plan.critical_magnitudes(known).items()
        ]
    return summary


def write_csv(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write rows that all have the same columns."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [])
        writer.writeheader()
        writer.writerows(rows)


def flatten_result(result: CellResult) -> dict[str, object]:
    """Return a result as one dict, with the fields of its cell."""
    fields = msgspec.structs.asdict(result)
    cell = fields.pop("cell")
    return {**msgspec.structs.asdict(cell), **fields}


def name_tests(campaign: CampaignFile, results: Sequence[CellResult]) -> list[str]:
    """Return a readable test name for each cell of the campaign."""
    units = magnitude_units(campaign)
    names = []
    for cell in (result.cell for result in results):
        size = units[cell.fault].describe(cell.magnitude)
        onset = cell.onset if isinstance(cell.onset, str) else f"{cell.onset:g} s"
        when = f"from {onset} for {cell.duration_s:g} s"
        what = f"{cell.fault} {size}".rstrip()
        names.append(f"{what}, {when}, {cell.scenario}, seed {cell.seed}")
    # Magnitudes may differ beyond the digits shown; the names of tests must differ.
    counts = Counter((r.cell.subject, name) for r, name in zip(results, names, strict=True))
    return [
        name if counts[r.cell.subject, name] == 1 else f"{name} (value {r.cell.magnitude})"
        for r, name in zip(results, names, strict=True)
    ]


def write_junit(path: Path, campaign: CampaignFile, results: list[CellResult]) -> None:
    """Write one test case per cell, which fails by its outcome, and one per requirement of it."""
    suite = ElementTree.Element("testsuite", name=campaign.name)
    failures = errors = 0
    for result, name in zip(results, name_tests(campaign, results), strict=True):
        cell = result.cell
        case = ElementTree.SubElement(
            suite,
            "testcase",
            classname=f"{campaign.name}.{cell.subject}",
            name=name,
            time=f"{result.wall_s:.3f}",
        )
        # JUnit distinguishes an error of the test from a failure of the subject.
        if result.outcome == ABORTED:
            errors += 1
            ElementTree.SubElement(case, "error", message=result.note)
        elif campaign.fails(msgspec.structs.replace(result, requirements=[])):
            failures += 1
            text = f"{result.outcome}; {result.failed or describe_excursions(result)}"
            ElementTree.SubElement(case, "failure", message=text)
        for one in result.requirements:
            case = ElementTree.SubElement(
                suite, "testcase", classname=f"{campaign.name}.{cell.subject}",
                name=f"{one.name}: {name}",
            )  # fmt: skip
            if one.met is None:
                ElementTree.SubElement(case, "skipped", message=one.reason)
            elif not one.met:
                failures += 1
                ElementTree.SubElement(case, "failure", message=one.describe())
    suite.set("tests", str(len(suite)))
    suite.set("failures", str(failures))
    suite.set("errors", str(errors))
    ElementTree.ElementTree(suite).write(path, encoding="utf-8", xml_declaration=True)


def describe_excursions(result: CellResult) -> str:
    """Describe the excursions beyond the reference flight."""
    angle = None if result.excursion_deg is None else f"{result.excursion_deg:.3g} degrees"
    position = None if result.excursion_m is None else f"{result.excursion_m:.3g} m"
    return " and ".join(filter(None, (angle, position))) + " beyond the reference flight"
