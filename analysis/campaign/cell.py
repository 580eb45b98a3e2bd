"""A test cell of a campaign, and its result."""

from typing import Any

import msgspec

from analysis.scoring.requirements import RequirementResult

HEALTHY = "healthy"  # the `fault` of a reference flight


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """One combination of subject under test, scenario and fault.

    `magnitude` is in the message field's unit, None for a fault or preset without one; `onset` is a
    time in seconds or the name of a phase of flight, as in the campaign file.
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
        """The unique name of the cell."""
        # Nine digits distinguish any two magnitudes of a bisection.
        return "|".join((*self.series, "" if self.magnitude is None else f"{self.magnitude:.9g}"))

    @property
    def series(self) -> tuple[str, ...]:
        """The part of the key shared by cells that differ only in their magnitude."""
        return (
            self.subject, self.scenario, self.fault, str(self.onset), f"{self.duration_s:g}",
            str(self.seed),
        )  # fmt: skip


class CellResult(msgspec.Struct, frozen=True, kw_only=True):
    """The result of a cell; times count from the start of the flight, delays from the onset.

    `outcome` is one of `outcomes.RANKS` or `aborted`, with the reason in `note`. Excursions are the
    largest errors beyond those of the reference flight. `detected_by` is the first flag, alarm or
    text that the reference flight lacks. `verdict` is the monitor's (`docs/verdicts.md`), `blamed`
    are the sensors it isolated, `verdict_s` is its delay; empty if no monitor ran. `failed` are the
    criteria on the vehicle that were missed.
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
    failed: str = ""
    wall_s: float = 0.0
    requirements: list[RequirementResult] = []


def file_key(*parts: Any) -> str:
    """Build a file name from parts."""
    # Keys contain bars and slashes, which file names must not.
    return "-".join("".join(c if c.isalnum() or c in "._" else "_" for c in str(p)) for p in parts)
