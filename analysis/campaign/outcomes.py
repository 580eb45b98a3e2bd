"""What a fault did to a flight: the definitions, in one place (docs/campaigns.md explains them).

A flight with a fault is held against its twin, the same scenario, seed and subject without it.
"""

import math
from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.campaign.cell import (
    ATTITUDE,
    PATH,
    POSITION,
    Cell,
    CellResult,
    Evidence,
    EvidenceCurve,
    FlightMark,
)

RANKS = ("unaffected", "detected", "degraded", "failsafe", "landed", "lost", "crashed")
ABORTED = "aborted"  # the flight could not be made; it says nothing of the subject
SAME_EVENT_S = 1.0  # a mark of the twin within so much of one of the flight's is the same event
Vector = NDArray[np.float64]


class OutcomeLimits(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """From where an excursion counts.

    Beyond `attitude_deg` or `position_m` a flight is degraded, beyond `lost_deg` or `lost_m` it is
    lost. `worse_from` is the outcome from which on a critical magnitude is sought.
    """

    attitude_deg: float = 5.0
    position_m: float = 10.0
    lost_deg: float = 45.0
    lost_m: float = 200.0
    worse_from: str = "degraded"

    def __post_init__(self) -> None:
        for name in ("attitude_deg", "position_m", "lost_deg", "lost_m"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} = {getattr(self, name)} is not positive; above 0")
        if self.worse_from not in RANKS[1:]:
            raise ValueError(
                f"worse_from = {self.worse_from} is unknown; known: {', '.join(RANKS[1:])}"
            )

    def is_worse(self, outcome: str) -> bool:
        """Whether an outcome is at least as bad as `worse_from`."""
        return outcome_rank(outcome) >= outcome_rank(self.worse_from)


def outcome_rank(outcome: str) -> int:
    """0 for unaffected, more for worse; -1 for a flight that could not be made."""
    return RANKS.index(outcome) if outcome in RANKS else -1


def classify_flight(
    cell: Cell, onset_s: float, flight: Evidence, twin: Evidence, limits: OutcomeLimits
) -> CellResult:
    """The outcome of a cell from what its flight and its twin showed."""
    angle = error_excursion(flight, twin, ATTITUDE, onset_s)
    flown = PATH[0] in flight.curves
    # By its place where that is known; an estimator moves nothing and is judged by its error.
    place = (
        path_excursion(flight, twin, onset_s)
        if flown
        else error_excursion(flight, twin, POSITION, onset_s)
    )
    excursion_deg, excursion_m = (float(c[1].max()) if len(c[1]) else None for c in (angle, place))
    # What the healthy twin shows too is not the fault's doing.
    new = new_marks(flight.marks, twin.marks, onset_s)
    # Reversed, so that the earliest of each kind stays in the dictionary.
    first = {mark.kind: mark for mark in reversed(new)}
    detected, failsafe = first.get("detected"), first.get("failsafe")
    ends_s = onset_s + cell.duration_s
    recoveries = [
        recovery_s(*curve, limit, ends_s)
        for curve, limit in ((angle, limits.attitude_deg), (place, limits.position_m))
        if len(curve[1]) and curve[1].max() > limit
    ]
    return CellResult(
        cell=cell,
        outcome=outcome_of(excursion_deg or 0.0, excursion_m or 0.0, set(first), limits),
        onset_s=onset_s,
        excursion_deg=excursion_deg,
        excursion_m=excursion_m,
        detected_s=None if detected is None else detected.t_s - onset_s,
        detected_by="" if detected is None else detected.text,
        # Recovered only when all that was beyond its limit is back.
        recovery_s=max(recoveries) if recoveries and None not in recoveries else None,  # type: ignore[type-var]
        failsafe="" if failsafe is None else failsafe.text,
        failsafe_s=None if failsafe is None else failsafe.t_s - onset_s,
    )


def outcome_of(
    excursion_deg: float, excursion_m: float, kinds: set[str], limits: OutcomeLimits
) -> str:
    """The worst that happened."""
    # Marks of a kind that is itself an outcome.
    happened = kinds & set(RANKS)
    if excursion_deg > limits.attitude_deg or excursion_m > limits.position_m:
        happened.add("degraded")
    if excursion_deg > limits.lost_deg or excursion_m > limits.lost_m:
        happened.add("lost")
    # Nothing happened, or only what has no rank.
    return max(happened, key=outcome_rank, default="unaffected")


def error_excursion(
    flight: Evidence, twin: Evidence, name: str, onset_s: float
) -> tuple[Vector, Vector]:
    """Times (n,) [s] from the onset on, and the curve beyond the twin's (n,); empty without it."""
    if name not in flight.curves or name not in twin.curves:
        return np.empty(0), np.empty(0)
    t_s, value = _arrays(flight.curves[name])
    # The outcome counts from the onset on.
    later = t_s >= onset_s
    t_s, value = t_s[later], value[later]
    # The twin flies the same seed: what differs is the fault alone.
    healthy = np.interp(t_s, *_arrays(twin.curves[name]))
    # An estimate that is no number is as wrong as can be.
    return t_s, np.where(np.isfinite(value), value - healthy, math.inf)


def path_excursion(flight: Evidence, twin: Evidence, onset_s: float) -> tuple[Vector, Vector]:
    """Times (n,) [s], and how far the vehicle was from where its twin was at that time (n,) [m]."""
    axes = [error_excursion(flight, twin, name, onset_s) for name in PATH]
    return axes[0][0], np.linalg.norm([difference for _, difference in axes], axis=0)


def _arrays(curve: EvidenceCurve) -> tuple[Vector, Vector]:
    return np.array(curve.t_s), np.array(curve.value)


def recovery_s(t_s: Vector, beyond: Vector, limit: float, ends_s: float) -> float | None:
    """Seconds from the fault's end until the excursion stays within the limit; None if never.

    `beyond` (n,) is the excursion in degrees or metres at the times `t_s` (n,), some of it outside.
    """
    outside = np.flatnonzero(beyond > limit)
    # Still outside at the end.
    if outside[-1] == len(t_s) - 1:
        return None
    # At least zero: it may have been back before the fault ended.
    return max(0.0, float(t_s[outside[-1] + 1]) - ends_s)


def new_marks(
    flight: Sequence[FlightMark], twin: Sequence[FlightMark], onset_s: float
) -> list[FlightMark]:
    """The marks from the onset on that the twin does not show at the same time."""

    def known(mark: FlightMark) -> bool:
        return any(
            (other.kind, other.text) == (mark.kind, mark.text)
            and abs(other.t_s - mark.t_s) <= SAME_EVENT_S
            for other in twin
        )

    return [mark for mark in flight if mark.t_s >= onset_s and not known(mark)]
