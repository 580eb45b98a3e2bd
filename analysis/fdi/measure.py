"""An epoch's usable satellites and what the model makes of them."""

from dataclasses import dataclass

import numpy as np

from analysis.fdi.config import SigmaModel
from analysis.fdi.inertial import CLOCK, DRIFT, ERRORS, ISB, X_CLOCK, X_DRIFT, X_ISB
from analysis.fdi.state import Stored
from analysis.gnss import WEEK_S, predict_ranges, satellite_states
from analysis.samples import Epoch, Vector

RANGE_LIMITS_M = (1.5e7, 6.0e7)  # medium orbits as seen from near the earth


@dataclass(frozen=True, slots=True)
class Observed:
    """Usable satellites of one epoch: parallel arrays (n,), states (n, 8) of `gnss`."""

    satellites: tuple[str, ...]
    pseudorange_m: Vector
    doppler_mps: Vector
    cn0_dbhz: Vector
    states: Vector
    galileo: Vector
    tow_s: float

    def select(self, keep: Vector) -> "Observed":
        """Those that `keep` (n,), a mask, lets pass."""
        return Observed(
            tuple(name for name, kept in zip(self.satellites, keep, strict=True) if kept),
            self.pseudorange_m[keep],
            self.doppler_mps[keep],
            self.cn0_dbhz[keep],
            self.states[keep],
            self.galileo[keep],
            self.tow_s,
        )


@dataclass(frozen=True, slots=True)
class Modelled:
    """Innovations at a state: ranges and rates with geometry.

    `v_m` and `v_mps` (n,), `los` (n, 3), `sigma_m` (n,), `elevation_rad` (n,), `h` (n, 18) of the
    ranges and `h_rate` (n, 18) of the rates.
    """

    v_m: Vector
    v_mps: Vector
    los: Vector
    sigma_m: Vector
    elevation_rad: Vector
    h: Vector
    h_rate: Vector

    def select(self, keep: Vector) -> "Modelled":
        """Those that `keep` (n,), a mask, lets pass."""
        return Modelled(
            self.v_m[keep],
            self.v_mps[keep],
            self.los[keep],
            self.sigma_m[keep],
            self.elevation_rad[keep],
            self.h[keep],
            self.h_rate[keep],
        )


def observe(
    epoch: Epoch, ephemerides: dict[str, tuple[Stored, ...]]
) -> tuple[Observed | None, str]:
    """The satellites that can be used; or None and the reason why there are none."""
    if not np.isfinite(epoch.tow_s) or not 0.0 <= epoch.tow_s <= WEEK_S:
        return None, f"time of week {epoch.tow_s} is none"
    keep, rows, known = [], [], 0
    low, high = RANGE_LIMITS_M
    for i, name in enumerate(epoch.satellites):
        stored = ephemerides.get(name)
        if stored is None:
            continue
        known += 1
        packed = _nearest(stored, epoch)
        if packed is not None and low < epoch.pseudorange_m[i] < high:
            keep.append(i)
            rows.append(packed)
    if not keep:
        return None, _why_none(epoch, ephemerides, known)
    ranges = epoch.pseudorange_m[keep]
    return Observed(
        tuple(epoch.satellites[i] for i in keep),
        ranges,
        epoch.doppler_mps[keep],
        epoch.cn0_dbhz[keep],
        satellite_states(np.array(rows), float(epoch.week), epoch.tow_s, ranges),
        np.array([epoch.satellites[i][0] == "E" for i in keep]),
        epoch.tow_s,
    ), ""


def _nearest(stored: tuple[Stored, ...], epoch: Epoch) -> Vector | None:
    """The packed ephemeris whose time is nearest, if one is healthy and still holds."""
    best, age = None, float("inf")
    for ephemeris, packed in stored:
        distance = abs((epoch.week - ephemeris.week) * WEEK_S + epoch.tow_s - ephemeris.toe_s)
        if distance < age and distance <= ephemeris.fit_half_s and ephemeris.health == 0:
            best, age = packed, distance
    return best


def _why_none(epoch: Epoch, ephemerides: dict[str, tuple[Stored, ...]], known: int) -> str:
    if not epoch.satellites:
        return "no pseudoranges"
    if not known:
        return "no ephemeris for any satellite in view"
    weeks = sorted({e.week for stored in ephemerides.values() for e, _ in stored})
    if epoch.week not in range(weeks[0] - 1, weeks[-1] + 2):
        return f"GPS week {epoch.week} does not fit the ephemerides of week {weeks[-1]}"
    return "no satellite has a valid ephemeris and a plausible pseudorange"


def model(observed: Observed, x: Vector, sigma: SigmaModel, ionosphere: Vector) -> Modelled:
    """Innovations, their geometry and sigma at the state x (19,)."""
    predicted = predict_ranges(observed.states, x[0:3], x[3:6], observed.tow_s, ionosphere)
    isb = np.where(observed.galileo, x[X_ISB], 0.0)
    count = len(observed.satellites)
    h = np.zeros((count, ERRORS))
    h[:, 0:3] = -predicted[:, 2:5]
    h[:, CLOCK] = 1.0
    h[:, ISB] = observed.galileo
    h_rate = np.zeros((count, ERRORS))
    h_rate[:, 3:6] = h[:, 0:3]
    h_rate[:, DRIFT] = 1.0
    return Modelled(
        v_m=observed.pseudorange_m - predicted[:, 0] - x[X_CLOCK] - isb,
        v_mps=observed.doppler_mps - predicted[:, 1] - x[X_DRIFT],
        los=predicted[:, 2:5],
        sigma_m=sigma.sigma_m(predicted[:, 5], observed.cn0_dbhz),
        elevation_rad=predicted[:, 5],
        h=h,
        h_rate=h_rate,
    )
