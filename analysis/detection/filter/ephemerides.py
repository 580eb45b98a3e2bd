"""The broadcast data that a receiver hands on, and which ephemeris each satellite is used with.

References
----------
.. [1] IS-GPS-200N, 20.3.4.4; Galileo OS SDD 1.3, 2.4.2; BDS-SIS-ICD-B1I 3.0, 5.2.4.9.
.. [2] GPS SPS Performance Standard, 5th edition, 2020: 4.42 times the upper bound of the URA.
"""

import math
from bisect import bisect_left
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.detection.values import Value
from analysis.orbits.broadcast import (
    CLOCK,
    CLOCK_OF,
    PACKED,
    SYSTEMS,
    pack_ephemeris,
    packed_for,
    satellite_states,
)
from analysis.samples.block import Indices
from analysis.samples.sample import (
    EphemerisSample,
    Epoch,
    IonosphereSample,
    Orbit,
    PreciseOrbit,
    Vector,
)
from mavproxy_fault.numerics.constants import L1_HZ
from mavproxy_fault.rinex.gps_clock import WEEK_S

StoredOrbit = tuple[Orbit, Vector]  # an ephemeris and its packed numbers
StoredOrbits = dict[str, tuple[StoredOrbit, ...]]  # by satellite, in the order of their times
RESELECT_S = 60.0  # a selection holds for one such part of the week
MOST_EPHEMERIDES = 2400  # per satellite: a week of precise orbits (2016), and of Galileo's own
# Galileo and BeiDou transmit an ephemeris from its time on, GPS and QZSS around it [1]_. An hour
# early it is off by 0.9 and 0.2 m (benchmarks/fdi.md): a file need not begin with the newest one.
EARLY_S = {"E": 3600.0, "C": 7200.0}  # BeiDou: 1.2 m two hours early, which is in the variance
TOLERATED_M = 4.42 * 2.4  # of a broadcast signal in space [2]_
SEEN_ACROSS = 0.24  # of a tangential error at most: the Earth is seen within 14 degrees
LEAST_COMPARED = 5  # satellites of a system: the median of fewer may be that of wrong ones
EARLY_COST = 2.0  # of the age before its time: errors grow four times as fast as after it


@dataclass(frozen=True, slots=True)
class EphemerisSelection:
    """The ephemerides of a set of satellites in one part of a week: indices of the satellites that
    have one (None: all have), their packed rows (n, 26), and the ephemerides `used`.

    `unused` says of the others, of the systems in use, why they have none. `differences_m` are
    those of broadcast from precise orbits in range, `contradicted` the ephemerides that are wrong
    by these.
    """

    satellites: tuple[str, ...]
    week: int
    part: float
    keep: Indices | None
    names: tuple[str, ...]
    packed: Vector
    system: Indices
    used: tuple[Orbit, ...]
    unused: dict[str, str]
    differences_m: dict[str, float]
    contradicted: frozenset[Orbit]

    def is_valid_for(self, epoch: Epoch) -> bool:
        """Whether the selection still holds for an epoch."""
        same = self.satellites == epoch.satellites and self.week == epoch.week
        return same and self.part == epoch.tow_s // RESELECT_S


class BroadcastData(Value, frozen=True):
    """Orbits by satellite, the selection made of them, and the ionosphere.

    `ionosphere` (9,) are Klobuchar's coefficients and the factor by which their error exceeds that
    of broadcast ones. The ephemerides `wrong` contradict the ranges and another ephemeris.
    """

    ephemerides: StoredOrbits
    ionosphere: Vector
    selection: EphemerisSelection | None = None
    wrong: frozenset[Orbit] = frozenset()

    def add(self, sample: EphemerisSample | IonosphereSample) -> "BroadcastData":
        """The data with what a sample says of orbits or the ionosphere."""
        if isinstance(sample, EphemerisSample):
            return self.add_ephemeris(sample.ephemeris)
        return self._replace(ionosphere=np.array((*sample.alpha, *sample.beta, 1.0)))

    def add_ephemeris(self, ephemeris: Orbit) -> "BroadcastData":
        """The data with one more ephemeris, which replaces a known ephemeris of the same time."""
        stored = self.ephemerides.get(ephemeris.satellite, ())
        at = bisect_left(stored, _time_of(ephemeris), key=lambda known: _time_of(known[0]))
        same_time = at < len(stored) and _time_of(stored[at][0]) == _time_of(ephemeris)
        if same_time and stored[at][0] == ephemeris:
            return self
        orbit = ephemeris, pack_ephemeris(ephemeris)
        # The oldest are dropped first.
        orbits = (*stored[:at], orbit, *stored[at + same_time :])[-MOST_EPHEMERIDES:]
        # A new ephemeris voids the selection.
        return self._replace(
            ephemerides={**self.ephemerides, ephemeris.satellite: orbits}, selection=None
        )


def _time_of(ephemeris: Orbit) -> tuple[int, float, bool]:
    return ephemeris.week, ephemeris.toe_s, isinstance(ephemeris, PreciseOrbit)


def select_ephemerides(
    epoch: Epoch,
    ephemerides: StoredOrbits,
    systems: str = SYSTEMS,
    wrong: Collection[Orbit] = (),
) -> EphemerisSelection:
    """Select the healthy ephemeris nearest in time for each satellite of an epoch that has one.

    `systems` are the first letters of the systems in use; the ephemerides `wrong` are not used.
    """
    keep, used, rows, unused = [], [], [], {}
    part = epoch.tow_s // RESELECT_S
    for i, name in enumerate(epoch.satellites):
        if name[0] not in systems:
            continue
        stored = [known for known in ephemerides.get(name, ()) if known[0] not in wrong]
        nearest = _nearest(stored, epoch.week, part * RESELECT_S)
        if nearest is None:
            unused[name] = _why_unused(stored, epoch)
            continue
        keep.append(i)
        ephemeris, packed = nearest
        used.append(ephemeris)
        carrier_hz = L1_HZ if epoch.carrier_hz is None else epoch.carrier_hz.item(i)
        second_hz = None
        if epoch.is_free and epoch.second is not None and epoch.second.carrier_hz is not None:
            second_hz = epoch.second.carrier_hz.item(i)
        if second_hz is not None or carrier_hz != L1_HZ:
            packed = packed_for(packed, ephemeris, carrier_hz, second_hz)
        rows.append(packed)
    names = tuple(epoch.satellites[i] for i in keep)
    differences_m, contradicted = _compare_with_precise(used, rows, epoch, ephemerides, wrong)
    return EphemerisSelection(
        epoch.satellites,
        epoch.week,
        part,
        np.array(keep, dtype=np.int64) if len(keep) < len(epoch.satellites) else None,
        names,
        np.array(rows).reshape(len(rows), PACKED),
        np.array([CLOCK_OF[name[0]] for name in names], dtype=np.int64),
        tuple(used),
        unused,
        differences_m,
        contradicted,
    )


def _compare_with_precise(
    used: Sequence[Orbit],
    rows: Sequence[Vector],
    epoch: Epoch,
    ephemerides: StoredOrbits,
    wrong: Collection[Orbit],
) -> tuple[dict[str, float], frozenset[Orbit]]:
    """How far the broadcast ephemeris of each satellite with a precise orbit would be off in range,
    and the ephemerides that are further off than their standard tolerates."""
    pairs = []
    for precise, row in zip(used, rows, strict=True):
        if isinstance(precise, PreciseOrbit):
            stored = ephemerides[precise.satellite]
            known = [e for e in stored if not isinstance(e[0], PreciseOrbit) and e[0] not in wrong]
            nearest = _nearest(known, epoch.week, epoch.tow_s)
            pairs += [(row, *nearest)] if nearest is not None else []
    if not pairs:
        return {}, frozenset()
    table = np.array([(row, packed) for row, _, packed in pairs]).reshape(-1, PACKED)
    states = satellite_states(table, float(epoch.week), epoch.tow_s, np.zeros(len(table)))
    places, moved = states[::2, :3], (states[1::2] - states[::2])
    up = places / np.linalg.norm(places, axis=1)[:, None]
    radial = (moved[:, :3] * up).sum(axis=1)
    across = SEEN_ACROSS * np.linalg.norm(moved[:, :3] - radial[:, None] * up, axis=1)
    off_m, system = radial - moved[:, CLOCK], np.array([e.satellite[0] for _, e, _ in pairs])
    for letter in set(system.tolist()):  # each system's clocks have a time scale of their own
        own = system == letter
        off_m[own] -= np.median(off_m[own]) if own.sum() >= LEAST_COMPARED else np.nan
    off_m += np.copysign(across, off_m)
    compared = zip((e for _, e, _ in pairs), off_m.round(2).tolist(), strict=True)
    found = [(e, metres) for e, metres in compared if math.isfinite(metres)]
    contradicted = frozenset(e for e, metres in found if abs(metres) > TOLERATED_M)
    return {e.satellite: metres for e, metres in found}, contradicted


def _nearest(stored: Sequence[StoredOrbit], week: int, tow_s: float) -> StoredOrbit | None:
    """The ephemeris nearest in time, if one is healthy and valid."""
    best, least_s = None, math.inf
    for known in stored:
        ephemeris = known[0]
        age_s = (week - ephemeris.week) * WEEK_S + tow_s - ephemeris.toe_s
        system = ephemeris.satellite[0]
        early_s = EARLY_S.get(system, ephemeris.fit_half_s)
        cost_s = max(age_s, -age_s * (EARLY_COST if system in EARLY_S else 1.0))
        if isinstance(ephemeris, PreciseOrbit):  # before every broadcast one
            early_s, cost_s = ephemeris.fit_half_s, abs(age_s) - WEEK_S
        is_valid = -early_s <= age_s <= ephemeris.fit_half_s and ephemeris.health == 0
        if is_valid and cost_s < least_s:
            best, least_s = known, cost_s
    return best


def _why_unused(stored: Sequence[StoredOrbit], epoch: Epoch) -> str:
    """Why a satellite without a usable ephemeris has none."""
    if not stored:
        return "no ephemeris"
    if any(ephemeris.health == 0 for ephemeris, _ in stored):
        stored = [known for known in stored if known[0].health == 0]
    ages_s = [(epoch.week - e.week) * WEEK_S + epoch.tow_s - e.toe_s for e, _ in stored]
    hours = min(ages_s, key=abs) / 3600.0
    if stored[0][0].health != 0:
        return "its ephemeris says that it is unhealthy"
    return f"its ephemeris is {abs(hours):.1f} h {'old' if hours > 0.0 else 'early'}"


def unusable_reason(epoch: Epoch, ephemerides: StoredOrbits) -> str:
    """Why an epoch has no usable satellite."""
    if not epoch.satellites:
        return "no pseudoranges"
    if not 0.0 <= epoch.tow_s <= WEEK_S:
        return f"time of week {epoch.tow_s} is not within 0 to {WEEK_S:.0f} s"
    if not any(name in ephemerides for name in epoch.satellites):
        return "no ephemeris for any satellite in view"
    weeks = sorted({e.week for stored in ephemerides.values() for e, _ in stored})
    if epoch.week not in range(weeks[0] - 1, weeks[-1] + 2):
        return f"GPS week {epoch.week} does not fit the ephemerides of week {weeks[-1]}"
    return "no satellite has a valid ephemeris and a plausible pseudorange"
