"""An epoch's usable satellites and what the model makes of them."""

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.detection_config import SigmaModel, SigmaNumbers, range_variance
from analysis.detection.filter.filter_state import StoredOrbit
from analysis.detection.filter.inertial import (
    CLOCK,
    DRIFT,
    ERROR_SIZE,
    ISB,
    X_CLOCK,
    X_DRIFT,
    X_ISB,
    V,
)
from analysis.detection.values import Value
from analysis.orbits.broadcast import (
    CLOCK_OF,
    DELAY,
    ELEVATION,
    LINE_OF_SIGHT,
    PACKED,
    RANGE,
    RATE,
    SYSTEMS,
    WEEK_S,
    packed_for_carrier,
    predict_ranges,
    satellite_states,
)
from analysis.samples.sample import Epoch, Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import L1_HZ

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
KLOBUCHAR_COEFFICIENTS = (
    8  # Klobuchar's; behind them, how much more than broadcast ones they are off
)
RESELECT_S = 300.0  # at the latest the choice is looked at again
# Of the variance, by clock: GLONASS's channels have delays of their own (RTKLIB's
# factor), BeiDou's B3I wanders as much more on a recorded walk.
SYSTEM_VARIANCE_FACTOR = (1.0, 1.0, 1.5**2, 1.5**2)
RANGE_LIMITS_M = (1.5e7, 6.0e7)  # medium orbits as seen from near the earth


class EpochMeasurements(NamedTuple):
    """n satellites as kernels read them: the fields of `EpochObservation` without the names."""

    packed: Vector
    pseudorange_m: Vector
    doppler_mps: Vector
    cn0_dbhz: Vector
    system: Indices
    week: float
    tow_s: float


class EpochObservation(Value, frozen=True):
    """Usable satellites of one epoch: parallel arrays (n,), their ephemerides packed (n, 25).

    `system` (n,) is each one's clock by `broadcast.CLOCK_OF`; `week` and `tow_s` are the
    receiver's time.
    """

    satellites: tuple[str, ...]
    pseudorange_m: Vector
    doppler_mps: Vector
    cn0_dbhz: Vector
    packed: Vector
    system: Indices
    week: float
    tow_s: float

    @property
    def measured(self) -> EpochMeasurements:
        """What was measured, without the names."""
        return EpochMeasurements(
            self.packed,
            self.pseudorange_m,
            self.doppler_mps,
            self.cn0_dbhz,
            self.system,
            self.week,
            self.tow_s,
        )

    @property
    def states(self) -> Vector:
        """Satellites (n, 9) when they sent what was received, as `broadcast.satellite_states`."""
        return transmitting_states(self.measured)

    def without_rates(self, names: Collection[str]) -> "EpochObservation":
        """The same without the Doppler rates of some satellites."""
        if not names:
            return self
        wrong = [name in names for name in self.satellites]
        return self._replace(doppler_mps=np.where(wrong, np.nan, self.doppler_mps))

    def select(self, keep: Mask) -> "EpochObservation":
        """Those that `keep` (n,), a mask, keeps."""
        names = tuple(
            name for name, kept in zip(self.satellites, keep.tolist(), strict=True) if kept
        )
        return EpochObservation(
            names,
            self.pseudorange_m[keep],
            self.doppler_mps[keep],
            self.cn0_dbhz[keep],
            self.packed[keep],
            self.system[keep],
            self.week,
            self.tow_s,
        )


class Innovations(NamedTuple):
    """Innovations at a state: ranges and rates with geometry.

    `v_m` and `v_mps` (n,), `variance` and `rate_variance` (n,) of both, `elevation_rad` (n,), the
    ionosphere's delay `ionosphere_m` (n,) by which its model may be off, and `h` (n, 20) of the
    ranges.
    """

    v_m: Vector
    v_mps: Vector
    variance: Vector
    rate_variance: Vector
    elevation_rad: Vector
    ionosphere_m: Vector
    h: Vector

    def between(self, begin: int, end: int) -> "Innovations":
        """Those in a row; views."""
        return Innovations(*(column[begin:end] for column in self))

    def select(self, keep: Mask) -> "Innovations":
        """Those that `keep` (n,), a mask, keeps."""
        return Innovations(*(column[keep] for column in self))


_NONE = np.empty(0)
NO_INNOVATIONS = Innovations(_NONE, _NONE, _NONE, _NONE, _NONE, _NONE, np.empty((0, ERROR_SIZE)))


@dataclass(frozen=True, slots=True)
class EphemerisSelection:
    """The ephemerides of a set of satellites, which hold from `from_us` until `until_us`: indices
    of those that have one (None: all have), and their packed rows (n, 25)."""

    satellites: tuple[str, ...]
    week: int
    from_us: int
    until_us: int
    keep: Indices | None
    names: tuple[str, ...]
    packed: Vector
    system: Indices

    def is_valid_for(self, epoch: Epoch) -> bool:
        """Whether the choice still holds for an epoch."""
        same = self.satellites == epoch.satellites and self.week == epoch.week
        return same and self.from_us <= epoch.t_us <= self.until_us


def select_ephemerides(
    epoch: Epoch,
    ephemerides: dict[str, tuple[StoredOrbit, ...]],
    systems: str = SYSTEMS,
    before: EphemerisSelection | None = None,
) -> EphemerisSelection:
    """The healthy ephemeris nearest in time for each satellite of an epoch that has one.

    `systems` are the first letters of those that are used, `before` is the last choice."""
    keep, rows, holds_s = [], [], RESELECT_S
    carriers = [L1_HZ] * len(epoch.satellites)
    if epoch.carrier_hz is not None:
        carriers = epoch.carrier_hz.tolist()
    for i, name in enumerate(epoch.satellites):
        packed, same_s = _nearest(ephemerides.get(name, ()), epoch)
        holds_s = min(holds_s, same_s)
        if packed is not None and name[0] in systems:
            keep.append(i)
            rows.append(packed if carriers[i] == L1_HZ else packed_for_carrier(packed, carriers[i]))
    names = tuple(epoch.satellites[i] for i in keep)
    # The same object where nothing changed: what follows compares it by identity first.
    names = before.names if before is not None and before.names == names else names
    return EphemerisSelection(
        epoch.satellites,
        epoch.week,
        epoch.t_us,
        epoch.t_us + int(holds_s * 1e6),
        np.array(keep, dtype=np.int64) if len(keep) < len(epoch.satellites) else None,
        names,
        np.array(rows).reshape(len(rows), PACKED),
        np.array([CLOCK_OF[name[0]] for name in names], dtype=np.int64),
    )


def observe_epoch(epoch: Epoch, chosen: EphemerisSelection) -> EpochObservation | None:
    """The satellites that can be used; None where there are none."""
    if not chosen.names or not 0.0 <= epoch.tow_s <= WEEK_S:
        return None
    columns = epoch.pseudorange_m, epoch.doppler_mps, epoch.cn0_dbhz
    if chosen.keep is not None:
        columns = columns[0][chosen.keep], columns[1][chosen.keep], columns[2][chosen.keep]
    observed = EpochObservation(
        chosen.names, *columns, chosen.packed, chosen.system, float(epoch.week), epoch.tow_s
    )
    if _all_plausible(columns[0]):
        return observed
    ranges = columns[0]
    plausible = (ranges > RANGE_LIMITS_M[0]) & (ranges < RANGE_LIMITS_M[1])
    return observed.select(plausible) if plausible.any() else None


@compiled
def _all_plausible(ranges: Vector) -> bool:
    """Whether all ranges lie within `RANGE_LIMITS_M`; one that is not finite does not."""
    plausible = True
    for i in range(ranges.shape[0]):
        plausible &= RANGE_LIMITS_M[0] < ranges[i] < RANGE_LIMITS_M[1]
    return plausible


def _nearest(stored: tuple[StoredOrbit, ...], epoch: Epoch) -> tuple[Vector | None, float]:
    """The packed ephemeris whose time is nearest, if one is healthy and still holds, and for how
    many seconds that stays so."""
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
    # Another one is nearer from half the way to it.
    changes_s += [0.5 * (to_come_s + ahead_s) for to_come_s in healthy]
    return best, min(change_s for change_s in changes_s if change_s >= 0.0)


def unusable_reason(epoch: Epoch, ephemerides: dict[str, tuple[StoredOrbit, ...]]) -> str:
    """Why `observe_epoch` found nothing to use."""
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


def predict_innovations(
    observed: EpochObservation, x: Vector, sigma: SigmaModel, ionosphere: Vector
) -> Innovations:
    """Innovations, their geometry and variance at the state x (21,).

    `ionosphere` (8,) or (9,) are Klobuchar's coefficients, and how much more than broadcast ones
    they are off.
    """
    return innovations_kernel(observed.measured, observed.states, x, ionosphere, sigma.numbers)


@compiled
def transmitting_states(measured: EpochMeasurements) -> Vector:
    """Satellites (n, 9) when they sent what was received, as `broadcast.satellite_states`."""
    return satellite_states(measured.packed, measured.week, measured.tow_s, measured.pseudorange_m)


@compiled
def innovations_kernel(
    measured: EpochMeasurements, states: Vector, x: Vector, ionosphere: Vector, sigma: SigmaNumbers
) -> Innovations:
    """The same for kernels, with the satellites (n, 9) of `transmitting_states`."""
    predicted = predict_ranges(states, x[0:3], x[3:6], measured.tow_s, ionosphere)
    count, elevation = states.shape[0], predicted[:, ELEVATION].copy()
    systems, range_m, rate_mps = measured.system, measured.pseudorange_m, measured.doppler_mps
    v, v_rate, rate_variance = np.empty(count), np.empty(count), np.empty(count)
    variance, h = range_variance(elevation, measured.cn0_dbhz, sigma), np.zeros((count, ERROR_SIZE))
    for i in range(count):
        system = systems[i]
        isb = x[X_ISB - 1 + system] if system > 0 else 0.0
        v[i] = range_m[i] - predicted[i, RANGE] - x[X_CLOCK] - isb
        v_rate[i] = rate_mps[i] - predicted[i, RATE] - x[X_DRIFT]
        variance[i] *= SYSTEM_VARIANCE_FACTOR[system]
        rate_variance[i] = sigma.rate_mps**2 / math.sin(max(elevation[i], 0.1))
        for k in range(3):
            h[i, k] = -predicted[i, LINE_OF_SIGHT + k]
        h[i, CLOCK] = 1.0
        if system > 0:
            h[i, ISB - 1 + system] = 1.0
    # Coefficients that nobody has sent are off by more: as if there were so much more to model.
    doubt = (
        ionosphere[KLOBUCHAR_COEFFICIENTS] if ionosphere.shape[0] > KLOBUCHAR_COEFFICIENTS else 1.0
    )
    delay_m = doubt * predicted[:, DELAY]
    return Innovations(v, v_rate, variance, rate_variance, elevation, delay_m, h)


@compiled
def rate_geometry(h: Vector, known: Indices) -> Vector:
    """The Doppler rates' geometry (k, 20) of the satellites `known` (k,) among those of h."""
    out = np.zeros((known.shape[0], h.shape[1]))
    for i in range(known.shape[0]):
        for k in range(3):
            out[i, V + k] = h[known[i], k]
        out[i, DRIFT] = 1.0
    return out
