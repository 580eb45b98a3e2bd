"""An epoch's usable satellites and what the model makes of them."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.fdi.config import SigmaModel, range_variance
from analysis.fdi.state import Stored
from analysis.gnss import PACKED, WEEK_S, predict_ranges, satellite_states
from analysis.samples import Epoch, Vector
from mavproxy_fault.wire.compiled import compiled

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
CHOSEN_US = 30_000_000  # the choice is looked at again
RANGE_LIMITS_M = (1.5e7, 6.0e7)  # medium orbits as seen from near the earth


class Observed(NamedTuple):
    """Usable satellites of one epoch: parallel arrays (n,), states (n, 8) of `gnss`."""

    satellites: tuple[str, ...]
    pseudorange_m: Vector
    doppler_mps: Vector
    cn0_dbhz: Vector
    states: Vector
    galileo: Vector
    tow_s: float

    def select(self, keep: Mask) -> "Observed":
        """Those that `keep` (n,), a mask, lets pass."""
        names = tuple(
            name for name, kept in zip(self.satellites, keep.tolist(), strict=True) if kept
        )
        return Observed(
            names,
            self.pseudorange_m[keep],
            self.doppler_mps[keep],
            self.cn0_dbhz[keep],
            self.states[keep],
            self.galileo[keep],
            self.tow_s,
        )


class Modelled(NamedTuple):
    """Innovations at a state: ranges and rates with geometry.

    `v_m` and `v_mps` (n,), `variance` and `rate_variance` (n,) of both, `elevation_rad` (n,),
    `h` (n, 18) of the ranges and `h_rate` (n, 18) of the rates.
    """

    v_m: Vector
    v_mps: Vector
    variance: Vector
    rate_variance: Vector
    elevation_rad: Vector
    h: Vector
    h_rate: Vector

    def select(self, keep: Mask) -> "Modelled":
        """Those that `keep` (n,), a mask, lets pass."""
        return Modelled(*(column[keep] for column in self))


_NONE, _NO_ROW = np.empty(0), np.empty((0, 18))
NO_ROWS = Modelled(_NONE, _NONE, _NONE, _NONE, _NONE, _NO_ROW, _NO_ROW)


@dataclass(frozen=True, slots=True)
class Chosen:
    """The ephemerides of a set of satellites, chosen until `until_us`: indices of those that have
    one, and their packed rows (n, 23)."""

    satellites: tuple[str, ...]
    week: int
    until_us: int
    keep: Indices
    names: tuple[str, ...]
    packed: Vector
    galileo: Vector

    def serves(self, epoch: Epoch) -> bool:
        """Whether the choice still holds for an epoch."""
        age_us = epoch.t_us - self.until_us + CHOSEN_US
        same = self.satellites == epoch.satellites and self.week == epoch.week
        return same and 0 <= age_us <= CHOSEN_US


def choose(epoch: Epoch, ephemerides: dict[str, tuple[Stored, ...]]) -> Chosen:
    """The healthy ephemeris nearest in time for each satellite of an epoch that has one."""
    keep, rows = [], []
    for i, name in enumerate(epoch.satellites):
        packed = _nearest(ephemerides.get(name, ()), epoch)
        if packed is not None:
            keep.append(i)
            rows.append(packed)
    names = tuple(epoch.satellites[i] for i in keep)
    return Chosen(
        epoch.satellites,
        epoch.week,
        epoch.t_us + CHOSEN_US,
        np.array(keep, dtype=np.int64),
        names,
        np.array(rows).reshape(len(rows), PACKED),
        np.array([name[0] == "E" for name in names], dtype=bool),
    )


def observe(epoch: Epoch, chosen: Chosen) -> Observed | None:
    """The satellites that can be used; None where there are none."""
    if not len(chosen.keep) or not 0.0 <= epoch.tow_s <= WEEK_S:
        return None
    keep, names, packed, galileo = chosen.keep, chosen.names, chosen.packed, chosen.galileo
    ranges = epoch.pseudorange_m[keep]
    if not RANGE_LIMITS_M[0] < ranges.min() <= ranges.max() < RANGE_LIMITS_M[1]:  # or not finite
        plausible = (ranges > RANGE_LIMITS_M[0]) & (ranges < RANGE_LIMITS_M[1])
        if not plausible.any():
            return None
        names = tuple(name for name, ok in zip(names, plausible, strict=True) if ok)
        keep, packed, galileo = keep[plausible], packed[plausible], galileo[plausible]
        ranges = ranges[plausible]
    return Observed(
        names,
        ranges,
        epoch.doppler_mps[keep],
        epoch.cn0_dbhz[keep],
        satellite_states(packed, float(epoch.week), epoch.tow_s, ranges),
        galileo,
        epoch.tow_s,
    )


def _nearest(stored: tuple[Stored, ...], epoch: Epoch) -> Vector | None:
    """The packed ephemeris whose time is nearest, if one is healthy and still holds."""
    best, age = None, float("inf")
    for ephemeris, packed in stored:
        distance = abs((epoch.week - ephemeris.week) * WEEK_S + epoch.tow_s - ephemeris.toe_s)
        if distance < age and distance <= ephemeris.fit_half_s and ephemeris.health == 0:
            best, age = packed, distance
    return best


def why_none(epoch: Epoch, ephemerides: dict[str, tuple[Stored, ...]]) -> str:
    """Why `observe` found nothing to use."""
    if not epoch.satellites:
        return "no pseudoranges"
    if not 0.0 <= epoch.tow_s <= WEEK_S:
        return f"time of week {epoch.tow_s} is none"
    if not any(name in ephemerides for name in epoch.satellites):
        return "no ephemeris for any satellite in view"
    weeks = sorted({e.week for stored in ephemerides.values() for e, _ in stored})
    if epoch.week not in range(weeks[0] - 1, weeks[-1] + 2):
        return f"GPS week {epoch.week} does not fit the ephemerides of week {weeks[-1]}"
    return "no satellite has a valid ephemeris and a plausible pseudorange"


def model(observed: Observed, x: Vector, sigma: SigmaModel, ionosphere: Vector) -> Modelled:
    """Innovations, their geometry and variance at the state x (19,)."""
    parts = _model(
        observed.states,
        observed.pseudorange_m,
        observed.doppler_mps,
        observed.cn0_dbhz,
        observed.galileo,
        x,
        observed.tow_s,
        ionosphere,
        sigma.numbers(),
    )
    return Modelled(*parts)


@compiled
def _model(
    states: Vector,
    pseudorange_m: Vector,
    doppler_mps: Vector,
    cn0_dbhz: Vector,
    galileo: Vector,
    x: Vector,
    tow_s: float,
    ionosphere: Vector,
    sigma: Vector,
) -> tuple[Vector, Vector, Vector, Vector, Vector, Vector, Vector]:
    predicted = predict_ranges(states, x[0:3], x[3:6], tow_s, ionosphere)
    count = states.shape[0]
    v, v_rate = np.empty(count), np.empty(count)
    h, h_rate = np.zeros((count, 18)), np.zeros((count, 18))
    rate_variance, elevation = np.empty(count), np.empty(count)
    for i in range(count):
        isb = x[18] if galileo[i] else 0.0
        v[i] = pseudorange_m[i] - predicted[i, 0] - x[16] - isb
        v_rate[i] = doppler_mps[i] - predicted[i, 1] - x[17]
        elevation[i] = predicted[i, 5]
        for k in range(3):
            h[i, k] = -predicted[i, 2 + k]
            h_rate[i, 3 + k] = -predicted[i, 2 + k]
        h[i, 15] = 1.0
        h[i, 17] = 1.0 if galileo[i] else 0.0
        h_rate[i, 16] = 1.0
        rate_variance[i] = sigma[4] ** 2 / math.sin(max(elevation[i], 0.1))
    variance = range_variance(elevation, cn0_dbhz, sigma)
    return v, v_rate, variance, rate_variance, elevation, h, h_rate
