"""Assess a flight: its checks, its verdict and all numbers of the report as one summary."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from analysis.report.curves.derived_curves import add_derived_curves
from analysis.report.curves.panels import BY_KEY
from analysis.report.curves.recording import FlightData, Span
from analysis.report.flight_checks import flight_checks
from analysis.report.flight_checks.level_checks import compare_motors
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FAIL, MET, PASS, WARN, FlightCheck, chain_of, verdict_of
from analysis.report.judging.fault_reaction import AFTER_FAULT_S, fault_reactions
from analysis.report.judging.flight_facts import flight_facts
from analysis.report.judging.flight_signals import judge_requirements
from analysis.report.judging.vehicle_record import vehicle_outcome
from analysis.report.recordings.flight_sources import RecordedFlight
from analysis.scoring.criteria import Criteria, check_missed_faults
from analysis.scoring.requirements import RequirementResult, read_requirements
from analysis.scoring.vehicle_outcome import is_crash_text

EVENTS_KEPT = 200  # chosen: of events with one text but for its numbers, in the summary
NUMBERS = re.compile(r"[-+]?\d+(\.\d+)?")
# Alarms and errors that are expected while a fault is injected: what it did to the vehicle is
# judged by the vehicle's outcome.
FAULT_EFFECTS = {
    "GPS fix", "GPS satellites", "GPS dilution of precision", "GPS jumps", "GPS jamming indicator",
    "innovation test ratios", "EKF variances", "compass field strength", "vibration",
    "accelerometer clipping", "messages of the autopilot", "flags of the autopilot",
    "system status of the autopilot", "estimate steps", "position against the truth",
    "height against the truth", "attitude against the truth",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class FlightAssessment:
    """A flight with derived curves, checks, verdict and summary."""

    flight: RecordedFlight
    checks: list[FlightCheck]
    verdict: str
    summary: dict[str, Any]


@np.errstate(invalid="ignore", over="ignore")  # a log may hold any bits as a number
def assess_flight(
    flight: RecordedFlight, thresholds: Thresholds, references: Sequence[FlightData] = ()
) -> FlightAssessment:
    """Add derived curves to a flight, run all checks, and summarise.

    `references` are assessed flights of the same vehicle.
    """
    recording = add_derived_curves(flight.recording)
    raw = flight_checks(recording, thresholds)
    raw += [compare_motors(recording, references, thresholds)] if references else []
    checks = [_expected(check, recording) for check in raw]
    faults = flight.summary.get("faults") or fault_reactions(flight.labels, recording, raw)
    # The criteria of a run, or, for any labelled log, that no fault was missed.
    missed = map(msgspec.structs.asdict, check_missed_faults(Criteria(), faults))
    checks += map(_criterion, flight.summary.get("criteria") or missed)
    requirements = read_requirements("requirements", thresholds.requirements)
    judged = judge_requirements(requirements, recording, flight.labels, flight.results)
    checks += map(_requirement_check, judged)
    # Failed checks become lanes of the timeline.
    recording = replace(recording, spans=recording.spans + _found(checks))
    flight = replace(flight, recording=recording)
    verdict = verdict_of(checks)
    return FlightAssessment(flight, checks, verdict, _summary(flight, checks, verdict, faults))


def _expected(check: FlightCheck, recording: FlightData) -> FlightCheck:
    """Pass a check whose alarms were all raised while a fault was injected."""
    injected = [span for span in recording.spans if span.kind == "injected"]
    if check.name not in FAULT_EFFECTS or check.verdict not in (WARN, FAIL) or not injected:
        return check
    # No fault makes a crash pass.
    if is_crash_text(check.evidence):
        return check
    inside = all(
        # One second earlier: a check's window may begin one sample before the fault.
        any(s.start_s - 1 <= start and end <= s.end_s + AFTER_FAULT_S for s in injected)
        for start, end in check.windows
    )
    if not inside:
        return check
    evidence = f"{check.evidence}; only while a fault was injected, as expected"
    return msgspec.structs.replace(check, verdict=PASS, evidence=evidence)


def _criterion(row: Mapping[str, Any]) -> FlightCheck:
    evidence = "no value" if row["value"] is None else str(row["value"])
    verdict = MET[row["passed"]]
    return FlightCheck(f"criterion: {row['name']}", verdict, evidence, str(row["limit"]))


def _requirement_check(one: RequirementResult) -> FlightCheck:
    windows = () if one.at_s is None or one.met else ((one.at_s, one.at_s),)
    return FlightCheck(
        f"requirement: {one.name}", MET[one.met], one.describe(), one.formula, windows
    )


def _found(checks: Sequence[FlightCheck]) -> list[Span]:
    """Windows of failed checks as spans; the autopilot's own reports have separate lanes."""
    return [
        Span(f"found: {check.name}", start, end, check.evidence, check.verdict.lower())
        for check in checks
        if check.verdict in (WARN, FAIL) and not check.name.endswith("of the autopilot")
        for start, end in check.windows
    ]


def _summary(
    flight: RecordedFlight,
    checks: Sequence[FlightCheck],
    verdict: str,
    faults: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    recording, run = flight.recording, flight.summary
    position = recording.curve("position-error", "fused", "estimate")
    position_rmse_m = _rms(position.value) if position else None
    events, omitted = _events(recording)
    return {
        "verdict": verdict,
        "outcome": msgspec.to_builtins(vehicle_outcome(recording)),
        "files": [str(path) for path in flight.paths],
        "autopilot": recording.autopilot,
        "sim_s": run.get("sim_s", round(recording.duration_s, 3)),
        "wall_s": run.get("wall_s"),
        "epochs": run.get("epochs", 0),
        "false_alarms": run.get("false_alarms"),
        "untestable_epochs": run.get("untestable_epochs", 0),
        "attitude_rmse_deg": run.get("attitude_rmse_deg", _attitude_rmse(recording)),
        "position_rmse_m": run.get("position_rmse_m", position_rmse_m),
        "faults": faults,
        "checks": [msgspec.structs.asdict(check) for check in checks],
        "chain": [
            {"t_s": round(t_s, 3), "check": check.name, "verdict": check.verdict}
            for t_s, check in chain_of(checks)
        ],
        "vehicle": recording.vehicle,
        "identity": recording.identity,
        "flight": dict(flight_facts(recording)),
        "signals": _numbers(recording),
        "links": [link._asdict() for link in recording.links],
        "spans": [span._asdict() for span in recording.spans],
        "events": events,
        "events_omitted": omitted,
        "parameters": {name: values[-1][1] for name, values in recording.parameters.items()},
        "notes": recording.notes,
        "size": recording.size,
        "junk_bytes": recording.junk_bytes,
    }  # fmt: skip


def _events(recording: FlightData) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """The first `EVENTS_KEPT` events of each kind and text, and how many more there are of each."""
    kept, counts = [], Counter[str]()
    for event in recording.events:
        subject = f"{event.kind}: {NUMBERS.sub('#', event.text)}"
        counts[subject] += 1
        if counts[subject] <= EVENTS_KEPT:
            kept.append(event._replace(t_s=round(event.t_s, 3))._asdict())
    omitted = {text: n - EVENTS_KEPT for text, n in counts.items() if n > EVENTS_KEPT}
    return kept, omitted


def _rms(values: np.typing.NDArray[np.float64]) -> float | None:
    good = values[np.isfinite(values)]
    return round(float(np.sqrt(np.mean(good**2))), 4) if len(good) else None


def _attitude_rmse(recording: FlightData) -> dict[str, float] | None:
    """RMSE of the autopilot's attitude if the log holds the truth."""
    found = {}
    for part in ("roll", "pitch", "yaw"):
        own = recording.curve(f"error-{part}", "autopilot")
        value = _rms(own.value) if own else None
        if value is not None:
            found[part] = value
    # All three axes are needed: a maximum over fewer would be too small.
    return {**found, "max": max(found.values())} if len(found) == 3 else None


def _numbers(recording: FlightData) -> dict[str, dict[str, dict[str, float | int | str]]]:
    """Extremes and percentiles of every curve."""
    found: dict[str, dict[str, dict[str, float | int | str]]] = {}
    for signal in recording.signals:
        good = signal.value[np.isfinite(signal.value)]
        if len(good) == 0:
            continue
        # Percentiles too: an extreme may be a single outlier.
        low, first, middle, last, high = np.percentile(good, (0, 1, 50, 99, 100)).tolist()
        found.setdefault(signal.panel, {})[signal.name] = {
            "unit": BY_KEY[signal.panel].unit,
            "samples": len(good),
            "min": low, "p1": first, "median": middle, "p99": last, "max": high,
            "start_s": float(signal.t_s[0]), "end_s": float(signal.t_s[-1]),
        }  # fmt: skip
    return found
