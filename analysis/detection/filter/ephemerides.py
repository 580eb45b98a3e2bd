"""The broadcast data that a receiver hands on, and which ephemeris each satellite is used with."""

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.detection.values import Value
from analysis.orbits.broadcast import (
    CLOCK_OF,
    PACKED,
    SYSTEMS,
    WEEK_S,
    pack_ephemeris,
    packed_for_carrier,
)
from analysis.samples.sample import Epoch, StateVector, Vector
from mavproxy_fault.numerics.constants import L1_HZ
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

Indices = NDArray[np.int64]
StoredOrbit = tuple[Ephemeris | StateVector, Vector]  # an ephemeris and its packed numbers
StoredOrbits = dict[str, tuple[StoredOrbit, ...]]  # by satellite, in the order of their times
RESELECT_S = 300.0  # a selection is renewed at least this often, whatever the fit intervals
MOST_EPHEMERIDES = 512  # per satellite: three days of Galileo ephemerides


@dataclass(frozen=True, slots=True)
class EphemerisSelection:
    """The ephemerides of a set of satellites, valid from `from_us` until `until_us`: indices of the
    satellites that have one (None: all have), and their packed rows (n, 25)."""

    satellites: tuple[str, ...]
    week: int
    from_us: int
    until_us: int
    keep: Indices | None
    names: tuple[str, ...]
    packed: Vector
    system: Indices

    def is_valid_for(self, epoch: Epoch) -> bool:
        """Whether the selection still holds for an epoch."""
        same = self.satellites == epoch.satellites and self.week == epoch.week
        return same and self.from_us <= epoch.t_us <= self.until_us


class BroadcastData(Value, frozen=True):
    """Orbits by satellite, the selection made of them, and the ionosphere.

    `ionosphere` (9,) are Klobuchar's coefficients and the factor by which their error exceeds that
    of broadcast ones.
    """

    ephemerides: StoredOrbits
    ionosphere: Vector
    selection: EphemerisSelection | None = None

    def add_ephemeris(self, ephemeris: Ephemeris | StateVector) -> "BroadcastData":
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


def _time_of(ephemeris: Ephemeris | StateVector) -> tuple[int, float]:
    return ephemeris.week, ephemeris.toe_s


def select_ephemerides(
    epoch: Epoch, ephemerides: StoredOrbits, systems: str = SYSTEMS
) -> EphemerisSelection:
    """Select the healthy ephemeris nearest in time for each satellite of an epoch that has one.

    `systems` are the first letters of the systems in use.
    """
    keep, rows, valid_s = [], [], RESELECT_S
    carriers = [L1_HZ] * len(epoch.satellites)
    if epoch.carrier_hz is not None:
        carriers = epoch.carrier_hz.tolist()
    for i, name in enumerate(epoch.satellites):
        packed, unchanged_s = _nearest(ephemerides.get(name, ()), epoch)
        valid_s = min(valid_s, unchanged_s)
        if packed is not None and name[0] in systems:
            keep.append(i)
            rows.append(packed if carriers[i] == L1_HZ else packed_for_carrier(packed, carriers[i]))
    names = tuple(epoch.satellites[i] for i in keep)
    return EphemerisSelection(
        epoch.satellites,
        epoch.week,
        epoch.t_us,
        epoch.t_us + int(valid_s * 1e6),
        np.array(keep, dtype=np.int64) if len(keep) < len(epoch.satellites) else None,
        names,
        np.array(rows).reshape(len(rows), PACKED),
        np.array([CLOCK_OF[name[0]] for name in names], dtype=np.int64),
    )


def _nearest(stored: tuple[StoredOrbit, ...], epoch: Epoch) -> tuple[Vector | None, float]:
    """The packed ephemeris nearest in time, if one is healthy and valid, and for how many seconds
    that stays so."""
    best, age, ahead_s, changes_s = None, float("inf"), 0.0, [float("inf")]
    healthy = []
    for ephemeris, packed in stored:
        to_come_s = (ephemeris.week - epoch.week) * WEEK_S + ephemeris.toe_s - epoch.tow_s
        if ephemeris.health != 0:
            continue
        healthy.append(to_come_s)
        changes_s += [to_come_s - ephemeris.fit_half_s, to_come_s + ephemeris.fit_half_s]
        if abs(to_come_s) < age and abs(to_come_s) <= ephemeris.fit_half_s:
            best, age, ahead_s = packed, abs(to_come_s), to_come_s
    # The next one is nearer from half the way to it.
    changes_s += [0.5 * (to_come_s + ahead_s) for to_come_s in healthy]
    return best, min(change_s for change_s in changes_s if change_s >= 0.0)


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
