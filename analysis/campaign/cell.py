"""A cell of a campaign and what became of it."""

from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

HEALTHY = "healthy"  # the fault of a twin
MONITOR = "monitor"  # the subject that is the project's own detector


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """One question to a subject.

    `magnitude` is in the field's unit, None for a fault or preset without one; `onset` is what the
    file says, a time in seconds or a phase of flight by name.
    """

    subject: str
    scenario: str
    fault: str
    magnitude: float | None = None
    onset: float | str = 0.0
    duration_s: float = 0.0
    seed: int = 1

    @property
    def key(self) -> str:
        """What tells it from all other cells."""
        # Nine digits tell any two magnitudes of a bisection apart.
        return "|".join((*self.series, "" if self.magnitude is None else f"{self.magnitude:.9g}"))

    @property
    def series(self) -> tuple[str, ...]:
        """What the cells that differ only in their magnitude have in common."""
        return (
            self.subject, self.scenario, self.fault, str(self.onset), f"{self.duration_s:g}",
            str(self.seed),
        )  # fmt: skip


class CellResult(msgspec.Struct, frozen=True, kw_only=True):
    """What became of a cell; times count from the start of the flight, delays from the onset.

    `outcome` is one of `outcomes.RANKS` or `aborted`, with the reason in `note`. Excursions are the
    largest errors beyond those of the twin. `detected_by` names the first flag, alarm or text that
    the twin does not show. `verdict` is what the project's monitor made of the fault in the same
    flight (`docs/verdicts.md`), `blamed` whom it found, `verdict_s` when; empty where none ran.
    """

    cell: Cell
    outcome: str
    onset_s: float = 0.0
    excursion_deg: float | None = None
    excursion_m: float | None = None
    detected_s: float | None = None
    detected_by: str = ""
    recovery_s: float | None = None
    failsafe: str = ""
    failsafe_s: float | None = None
    verdict: str = ""
    blamed: str = ""
    verdict_s: float | None = None
    note: str = ""
    wall_s: float = 0.0


class FlightMark(msgspec.Struct, frozen=True):
    """Something that happened: `kind` is detected, failsafe, landed, lost or crashed."""

    t_s: float
    kind: str
    text: str = ""


class EvidenceCurve(msgspec.Struct, frozen=True):
    """Samples of one quantity over the flight."""

    t_s: list[float]
    value: list[float]


class Evidence(msgspec.Struct, frozen=True):
    """What a flight showed of a subject: curves by name, and marks in order of time."""

    curves: dict[str, EvidenceCurve] = {}
    marks: list[FlightMark] = []


ATTITUDE, POSITION = "attitude error, deg", "position error, m"
PATH = ("north, m", "east, m", "up, m")  # curves of where the vehicle truly was


class CellVerdict(msgspec.Struct, frozen=True):
    """What the monitor made of a flight's fault: the word, whom it blamed, after how long."""

    word: str = ""
    blamed: str = ""
    delay_s: float | None = None


def monitor_verdict(faults: Sequence[Mapping[str, Any]]) -> CellVerdict:
    """The monitor's verdict from the `faults` of a summary; of a preset's parts the first found."""
    if not faults:
        return CellVerdict()
    found = [fault for fault in faults if fault["delay_s"] is not None]
    first = min(found, key=lambda fault: fault["delay_s"]) if found else faults[0]
    # Somebody may have been blamed several times.
    blamed = dict.fromkeys([*first["isolated"], *(blame["who"] for blame in first["wrongly"])])
    return CellVerdict(first["verdict"], ", ".join(blamed), first["delay_s"])


class CampaignFlight(msgspec.Struct, frozen=True):
    """A flight that is over: evidence by subject, when each phase began, and how long it took."""

    evidence: dict[str, Evidence]
    phases: dict[str, float] = {}
    duration_s: float = 0.0
    wall_s: float = 0.0
    folder: str = ""
    verdict: CellVerdict = CellVerdict()


def file_key(*parts: Any) -> str:
    """A name for a file, made of parts."""
    # Keys hold bars and slashes, which no file's name should.
    return "-".join("".join(c if c.isalnum() or c in "._" else "_" for c in str(p)) for p in parts)
