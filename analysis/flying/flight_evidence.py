"""The evidence of a flight: curves, events and requirements by subject, the monitor's verdict."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import msgspec

from analysis.results import AttitudeError, Result
from analysis.scoring.requirements import RequirementResult
from analysis.scoring.vehicle_outcome import VehicleEvent

MONITOR = "monitor"  # the subject name of the project's own detector


class EvidenceCurve(msgspec.Struct, frozen=True):
    """Samples of one quantity over the flight."""

    t_s: list[float]
    value: list[float]


class Evidence(msgspec.Struct, frozen=True):
    """Records of a subject in a flight: curves by name, and marks in order of time."""

    curves: dict[str, EvidenceCurve] = {}
    marks: list[VehicleEvent] = []


ATTITUDE, POSITION = "attitude error, deg", "position error, m"
WIDEST_DEG = 180.0
PATH = ("north, m", "east, m", "up, m")  # curves of the true position


def seconds_since(result: Result, t0_us: int) -> float:
    """The time of a result in seconds from `t0_us`."""
    return round((result.t_us - t0_us) * 1e-6, 3)


def attitude_curve(
    results: Iterable[Result], estimators: Sequence[str], t0_us: int
) -> dict[str, EvidenceCurve]:
    """The attitude error of these estimators over seconds since `t0_us`; none without results."""
    errors = [r for r in results if isinstance(r, AttitudeError) and r.estimator in estimators]
    # An estimate of NaN counts as the largest possible error.
    degrees = [round(e.angle, 4) if math.isfinite(e.angle) else WIDEST_DEG for e in errors]
    curve = EvidenceCurve([seconds_since(e, t0_us) for e in errors], degrees)
    return {ATTITUDE: curve} if errors else {}


class CellVerdict(msgspec.Struct, frozen=True):
    """The monitor's verdict on a fault, the sensors it isolated (`blamed`), and its delay."""

    word: str = ""
    blamed: str = ""
    delay_s: float | None = None


def monitor_verdict(faults: Sequence[Mapping[str, Any]]) -> CellVerdict:
    """Take the verdict from the `faults` of a summary; of a preset's parts, the first detected."""
    if not faults:
        return CellVerdict()
    detected = [fault for fault in faults if fault["delay_s"] is not None]
    first = min(detected, key=lambda fault: fault["delay_s"]) if detected else faults[0]
    # A sensor may have been isolated several times.
    isolated = dict.fromkeys([*first["isolated"], *(row["who"] for row in first["wrongly"])])
    return CellVerdict(first["verdict"], ", ".join(isolated), first["delay_s"])


class CampaignFlight(msgspec.Struct, frozen=True):
    """A completed flight: evidence and requirements by subject, start of each phase [s], duration,
    start of the first fault, and the attitude scores of a run's summary."""

    evidence: dict[str, Evidence]
    phases: dict[str, float] = {}
    duration_s: float = 0.0
    wall_s: float = 0.0
    folder: str = ""
    verdict: CellVerdict = CellVerdict()
    failed: str = ""
    requirements: dict[str, list[RequirementResult]] = {}
    fault_s: float | None = None
    attitude: dict[str, Any] = {}

    @property
    def behaviour(self) -> str:
        """What the first subject did: its first alarm or flag, its failsafe, its end."""
        marks = next(iter(self.evidence.values())).marks
        first = {mark.kind: mark.text for mark in reversed(marks)}
        return "; ".join(f"{kind}: {text}" for kind, text in first.items())
