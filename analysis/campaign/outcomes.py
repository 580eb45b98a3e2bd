"""Definitions of the outcomes of a test cell (explained in docs/campaigns.md).

A flight with a fault is compared with its reference flight: the same scenario, seed and subject
without the fault.
"""

import math
from collections.abc import Sequence

import numpy as np

from analysis.campaign.cell import Cell, CellResult
from analysis.flying.flight_evidence import (
    ATTITUDE,
    PATH,
    POSITION,
    Evidence,
    EvidenceCurve,
)
from analysis.scoring.vehicle_outcome import FLEW_AWAY, UNAFFECTED, VEHICLE_OUTCOMES, VehicleEvent
from mavproxy_fault.documents.document_check import Section
from mavproxy_fault.numerics.arrays import Array

LOST = "lost"  # of an estimate, while the vehicle may be well, and of a flight that ended early
BEST = VEHICLE_OUTCOMES.index(UNAFFECTED)
WORSE = VEHICLE_OUTCOMES.index(FLEW_AWAY)
RANKS = (*VEHICLE_OUTCOMES[BEST:WORSE], LOST, *VEHICLE_OUTCOMES[WORSE:])
ABORTED = "aborted"  # the flight failed to run, which says nothing about the subject
SAME_EVENT_S = 1.0  # marks this close are one event: a period of HEARTBEAT, which has the mode


class OutcomeLimits(Section, frozen=True):
    """Limits of the excursions.

    Beyond `attitude_deg` or `position_m` a flight is degraded. Beyond `lost_deg` or `lost_m` an
    estimate is lost; a vehicle that far off its path flew away. A critical magnitude is the
    smallest with the outcome `worse_from` or worse. A cell fails from `fail_from` on, by
    default from `worse_from`.
    """

    attitude_deg: float = 5.0
    position_m: float = 10.0
    lost_deg: float = 45.0
    lost_m: float = 200.0
    worse_from: str = "degraded"
    fail_from: str | None = None

    def __post_init__(self) -> None:
        for name in ("attitude_deg", "position_m", "lost_deg", "lost_m"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"{name} = {getattr(self, name)} must be above 0")
        for name in ("worse_from", "fail_from"):
            value = getattr(self, name)
            # Only a failure can be none of the vehicle's outcomes.
            known = (*RANKS[1:], ABORTED) if name == "fail_from" else RANKS[1:]
            if value is not None and value not in known:
                raise ValueError(f"{name} = {value} is unknown; known: {', '.join(known)}")

    def is_worse(self, outcome: str) -> bool:
        """Whether an outcome is at least as bad as `worse_from`."""
        return outcome_rank(outcome) >= outcome_rank(self.worse_from)


def outcome_rank(outcome: str) -> int:
    """Return 0 for unaffected, more for worse outcomes, and -1 for aborted."""
    return RANKS.index(outcome) if outcome in RANKS else -1


def classify_flight(
    cell: Cell, onset_s: float, flight: Evidence, reference: Evidence, limits: OutcomeLimits
) -> CellResult:
    """Determine the outcome of a cell from the evidence of its flight and its reference flight."""
    angle = error_excursion(flight, reference, ATTITUDE, onset_s)
    has_path = PATH[0] in flight.curves
    # An autopilot by the vehicle's true path, an estimator by its position error.
    position = (
        path_excursion(flight, reference, onset_s)
        if has_path
        else error_excursion(flight, reference, POSITION, onset_s)
    )
    excursion_deg, excursion_m = (
        float(c[1].max()) if len(c[1]) else None for c in (angle, position)
    )
    # The fault did not cause marks that the reference flight has too.
    new = new_marks(flight.marks, reference.marks, onset_s)
    # An estimator that is lost without the fault too has no excursion, but fails all the same.
    if largest_error(flight, ATTITUDE, onset_s) > limits.lost_deg or (
        largest_error(flight, POSITION, onset_s) > limits.lost_m and not has_path
    ):
        new.append(VehicleEvent(onset_s, LOST))
    # Reversed, so that the earliest of each kind stays in the dictionary.
    first = {mark.kind: mark for mark in reversed(new)}
    detected, failsafe = first.get("detected"), first.get("failsafe")
    ends_s = onset_s + cell.duration_s
    recoveries = [
        recovery_s(*curve, limit, ends_s)
        for curve, limit in ((angle, limits.attitude_deg), (position, limits.position_m))
        if len(curve[1]) and curve[1].max() > limit
    ]
    return CellResult(
        cell=cell,
        outcome=outcome_of(
            excursion_deg or 0.0, excursion_m or 0.0, set(first), limits, of_vehicle=has_path
        ),
        onset_s=onset_s,
        excursion_deg=excursion_deg,
        excursion_m=excursion_m,
        detected_s=None if detected is None else detected.t_s - onset_s,
        detected_by="" if detected is None else detected.text,
        # Recovered once all excursions are back within their limits.
        recovery_s=max(recoveries) if recoveries and None not in recoveries else None,  # type: ignore[type-var]
        failsafe="" if failsafe is None else failsafe.text,
        failsafe_s=None if failsafe is None else failsafe.t_s - onset_s,
    )


def outcome_of(
    excursion_deg: float,
    excursion_m: float,
    kinds: set[str],
    limits: OutcomeLimits,
    *,
    of_vehicle: bool = False,
) -> str:
    """Return the worst outcome that applies."""
    # Marks whose kind is itself an outcome.
    happened = kinds & set(RANKS)
    if excursion_deg > limits.attitude_deg or excursion_m > limits.position_m:
        happened.add("degraded")
    if excursion_m > limits.lost_m:
        happened.add(FLEW_AWAY if of_vehicle else LOST)
    if excursion_deg > limits.lost_deg:
        happened.add(LOST)
    # Unaffected if nothing with a rank happened.
    return max(happened, key=outcome_rank, default="unaffected")


def largest_error(flight: Evidence, name: str, onset_s: float) -> float:
    """Return the largest error since the onset; 0 if there is none."""
    t_s, value = _arrays(flight.curves.get(name, EvidenceCurve([], [])))
    return float(np.max(value[t_s >= onset_s], initial=0.0))


def error_excursion(
    flight: Evidence, reference: Evidence, name: str, onset_s: float
) -> tuple[Array, Array]:
    """Return times (n,) [s] since the onset and flight minus reference (n,); empty if missing."""
    if name not in flight.curves or name not in reference.curves:
        return np.empty(0), np.empty(0)
    t_s, value = _arrays(flight.curves[name])
    # The outcome counts from the onset.
    later = t_s >= onset_s
    t_s, value = t_s[later], value[later]
    # The reference flight has the same seed, so any difference is due to the fault.
    healthy = np.interp(t_s, *_arrays(reference.curves[name]))
    # An estimate of NaN counts as infinitely wrong.
    return t_s, np.where(np.isfinite(value), value - healthy, math.inf)


def path_excursion(flight: Evidence, reference: Evidence, onset_s: float) -> tuple[Array, Array]:
    """Return times (n,) [s], and the vehicle's distance to the reference flight (n,) [m]."""
    axes = [error_excursion(flight, reference, name, onset_s) for name in PATH]
    return axes[0][0], np.linalg.norm([difference for _, difference in axes], axis=0)


def _arrays(curve: EvidenceCurve) -> tuple[Array, Array]:
    return np.array(curve.t_s), np.array(curve.value)


def recovery_s(t_s: Array, beyond: Array, limit: float, ends_s: float) -> float | None:
    """Return the seconds from the fault's end until the excursion stays within the limit, or None.

    `beyond` (n,) is the excursion in degrees or metres at the times `t_s` (n,); at least one value
    exceeds `limit`.
    """
    outside = np.flatnonzero(beyond > limit)
    # Still outside at the end of the flight.
    if outside[-1] == len(t_s) - 1:
        return None
    # At least zero: it may have returned before the fault ended.
    return max(0.0, float(t_s[outside[-1] + 1]) - ends_s)


def new_marks(
    flight: Sequence[VehicleEvent], reference: Sequence[VehicleEvent], onset_s: float
) -> list[VehicleEvent]:
    """Return the marks since the onset that the reference flight lacks at the same time."""

    def in_reference(mark: VehicleEvent) -> bool:
        return any(
            (other.kind, other.text) == (mark.kind, mark.text)
            and abs(other.t_s - mark.t_s) <= SAME_EVENT_S
            for other in reference
        )

    return [mark for mark in flight if mark.t_s >= onset_s and not in_reference(mark)]
