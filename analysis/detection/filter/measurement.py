"""The usable measurements of an epoch, and their innovations against a state of the filter.

References
----------
.. [1] IS-GPS-200N, 20.3.3.3.3.3.
"""

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import compress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.filter.ephemerides import (
    BroadcastData,
    EphemerisSelection,
    select_ephemerides,
)
from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.inertial import (
    CLOCK,
    ERROR_SIZE,
    ISB,
    X_CLOCK,
    X_DRIFT,
    X_ISB,
)
from analysis.detection.filter.information import NormalEquations, normal_equations
from analysis.detection.filter.range_noise import SigmaModel, SigmaNumbers, range_variance
from analysis.detection.values import Value
from analysis.orbits.broadcast import (
    DELAY,
    ELEVATION,
    LINE_OF_SIGHT,
    NOISE,
    RANGE,
    RATE,
    TOE,
    WEEK,
    free_share,
    predict_ranges,
    satellite_states,
)
from analysis.samples.block import Indices
from analysis.samples.sample import Epoch, Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import L1_HZ
from mavproxy_fault.rinex.gps_clock import WEEK_S

Mask = NDArray[np.bool_]
# Klobuchar's; the element behind them is the factor by which their error exceeds broadcast ones'
KLOBUCHAR_COEFFICIENTS = 8
# Error of an ephemeris in m, times the square of its age in h, before its time and after it, by
# clock: measured against later ephemerides (benchmarks/fdi.md). GPS's is flat as long as it holds.
EARLY_ERROR_M, LATE_ERROR_M = (0.0, 1.0, 7.5, 0.3), (0.0, 0.25, 7.5, 0.3)
# Second bands, by system, whose group delays the broadcast messages give: those of L5, B1C and B2a
# are in messages that are not read (CNAV, B-CNAV), and without them metres are left. Not of QZSS:
# receivers delay its L2C and GPS's L2 P(Y) differently, and the two share a clock.
COMBINED = {"G": "2", "R": "2", "E": "57", "C": "6"}
RANGE_LIMITS_M = (1.5e7, 6.0e7)  # medium and geosynchronous orbits as seen from near the Earth


class EpochMeasurements(NamedTuple):
    """The measurements of n satellites: arrays (n,), and their ephemerides packed (n, 26).

    `system` (n,) is each one's clock by `broadcast.CLOCK_OF`; `week` and `tow_s` are the receiver's
    time.
    """

    packed: Vector
    pseudorange_m: Vector
    doppler_mps: Vector
    cn0_dbhz: Vector
    system: Indices
    week: float
    tow_s: float


class EpochObservation(Value, frozen=True):
    """The usable satellites of one epoch and their measurements, in the same order."""

    satellites: tuple[str, ...]
    measurements: EpochMeasurements

    @property
    def satellite_states(self) -> Vector:
        """Satellites (n, 9) at transmission, as `broadcast.satellite_states`."""
        m = self.measurements
        return satellite_states(m.packed, m.week, m.tow_s, m.pseudorange_m)

    def without_rates(self, names: Collection[str]) -> "EpochObservation":
        """The observation without the Doppler rates of the satellites `names`."""
        if not names:
            return self
        wrong = [name in names for name in self.satellites]
        rates = np.where(wrong, np.nan, self.measurements.doppler_mps)
        return self._replace(measurements=self.measurements._replace(doppler_mps=rates))

    def select(self, keep: Mask) -> "EpochObservation":
        """The satellites that the mask `keep` (n,) selects."""
        m = self.measurements
        *columns, _, _ = m._fields  # week and time are the receiver's
        selected = m._replace(**{name: getattr(m, name)[keep] for name in columns})
        return EpochObservation(tuple(compress(self.satellites, keep)), selected)


class Innovations(NamedTuple):
    """Ranges and Doppler rates of n satellites minus their predictions, with geometry and noise.

    `range_m` and `rate_mps` (n,) are the innovations, `variance` and `rate_variance` (n,) the
    noise of each, `white` (n,) the part of a range's variance that is independent from epoch to
    epoch, `elevation_rad` (n,), the ionospheric delay `ionosphere_m` (n,) by which its model may be
    off, and `geometry` (n, 20) the ranges' derivatives by the errors of the state.
    """

    range_m: Vector
    rate_mps: Vector
    variance: Vector
    rate_variance: Vector
    white: Vector
    elevation_rad: Vector
    ionosphere_m: Vector
    geometry: Vector

    def select(self, keep: Mask) -> "Innovations":
        """The satellites that the mask `keep` (n,) selects."""
        return Innovations(*(column[keep] for column in self))

    def without(self, rows: Sequence[int]) -> "Innovations":
        """The satellites but those in some rows."""
        return self.select(~np.isin(np.arange(len(self.range_m)), rows))

    def equations(self) -> NormalEquations:
        """The normal equations of the ranges."""
        return normal_equations(self.geometry, self.variance, self.range_m, self.white)


def systems_in_use(geometry: Vector) -> Vector:
    """The systems in use (n, systems) by a geometry (n, 20), 1 where a satellite is of one."""
    offsets = geometry[:, ISB:]
    systems = np.column_stack((1.0 - offsets.sum(axis=1), offsets))
    return systems[:, systems.any(axis=0)]


_NONE = np.empty(0)
NO_INNOVATIONS = Innovations(*(7 * (_NONE,)), np.empty((0, ERROR_SIZE)))


def observe_epoch(epoch: Epoch, selection: EphemerisSelection) -> EpochObservation | None:
    """The satellites of an epoch that can be used; None where there are none."""
    if not selection.names or not 0.0 <= epoch.tow_s <= WEEK_S:
        return None
    columns = epoch.pseudorange_m, epoch.doppler_mps, epoch.cn0_dbhz
    if selection.keep is not None:
        keep = selection.keep
        columns = columns[0][keep], columns[1][keep], columns[2][keep]
    measurements = EpochMeasurements(
        selection.packed, *columns, selection.system, float(epoch.week), epoch.tow_s
    )
    observation, ranges = EpochObservation(selection.names, measurements), columns[0]
    plausible = (ranges > RANGE_LIMITS_M[0]) & (ranges < RANGE_LIMITS_M[1])
    if plausible.all():
        return observation
    return observation.select(plausible) if plausible.any() else None


def shares_of_first(epoch: Epoch, second: Epoch) -> Vector:
    """The weight (n,) of the first range of each satellite in the combination, NaN without one."""
    first_hz = L1_HZ if epoch.carrier_hz is None else epoch.carrier_hz
    return free_share(first_hz, L1_HZ if second.carrier_hz is None else second.carrier_hz)


def ionosphere_free(epoch: Epoch) -> Epoch:
    """The epoch with the ionosphere-free ranges [1]_, of the satellites that have two, the second
    on their system's most frequent signal: a receiver delays each signal differently, and a system
    has one clock. Unchanged without a second frequency."""
    if epoch.second is None:
        return epoch
    share, signals = shares_of_first(epoch, epoch.second), epoch.second.signals
    range_m = share * epoch.pseudorange_m + (1.0 - share) * epoch.second.pseudorange_m
    kinds = [(name[0], signal) for name, signal in zip(epoch.satellites, signals, strict=True)]
    counts = Counter(kind for kind in kinds if kind[1][:1] in COMBINED.get(kind[0], ""))
    usual = dict(kind for kind, _ in reversed(counts.most_common()))
    known = [usual.get(system) == signal for system, signal in kinds]
    free = replace(epoch, pseudorange_m=range_m, is_free=True)
    return free.select((np.isfinite(range_m) & known).nonzero()[0].tolist())


def observe(
    epoch: Epoch, broadcast: BroadcastData, config: FilterConfig
) -> tuple[EpochObservation | None, BroadcastData]:
    """The observation (None: no satellite is usable), and the broadcast data with its selection."""
    if config.ionosphere_free:
        epoch = ionosphere_free(epoch)
    selection, wrong = broadcast.selection, broadcast.wrong
    if selection is None or not selection.is_valid_for(epoch):
        selection = select_ephemerides(epoch, broadcast.ephemerides, config.systems, wrong)
        wrong = wrong.union(selection.contradicted)
        broadcast = broadcast._replace(selection=selection, wrong=wrong)
    return observe_epoch(epoch, selection), broadcast


def predict_innovations(
    observation: EpochObservation, x: Vector, sigma: SigmaModel, ionosphere: Vector
) -> Innovations:
    """Innovations, their geometry and variance at the state x (21,).

    `ionosphere` (8,) or (9,) are Klobuchar's coefficients, and the factor by which their error
    exceeds that of broadcast ones.
    """
    states = observation.satellite_states
    return compare_with_prediction(observation.measurements, states, x, ionosphere, sigma)


def compare_with_prediction(
    measurements: EpochMeasurements,
    states: Vector,
    x: Vector,
    ionosphere: Vector,
    sigma: SigmaModel,
) -> Innovations:
    """`predict_innovations` with the satellites (n, 9) of `EpochObservation.satellite_states`."""
    predicted = predict_ranges(states, x[0:3], x[3:6], measurements.tow_s, ionosphere)
    table, geometry = _innovations(measurements, predicted, x, sigma.numbers)
    # Coefficients that were not broadcast err by more: as if there were more delay to model.
    if len(ionosphere) > KLOBUCHAR_COEFFICIENTS:
        table[-1] *= ionosphere[KLOBUCHAR_COEFFICIENTS]
    return Innovations._make((*table, geometry))


@compiled
def _innovations(
    measurements: EpochMeasurements, predicted: Vector, x: Vector, sigma: SigmaNumbers
) -> tuple[Vector, Vector]:
    """The columns of `Innovations` but the last (7, n), and the last (n, 20); `predicted` (n, 8) of
    `broadcast.predict_ranges`."""
    out, h = np.empty((7, predicted.shape[0])), np.zeros((predicted.shape[0], ERROR_SIZE))
    for i in range(h.shape[0]):
        system, elevation = measurements.system[i], predicted[i, ELEVATION]
        isb = x[X_ISB - 1 + system] if system > 0 else 0.0
        week, toe = measurements.packed[i, WEEK], measurements.packed[i, TOE]
        age_s = (measurements.week - week) * WEEK_S + measurements.tow_s - toe
        growth_m = EARLY_ERROR_M[system] if age_s < 0.0 else LATE_ERROR_M[system]
        all_m2, white_m2 = range_variance(elevation, measurements.cn0_dbhz[i], sigma)
        share = sigma.systems[system] ** 2 * measurements.packed[i, NOISE]
        out[0, i] = measurements.pseudorange_m[i] - predicted[i, RANGE] - x[X_CLOCK] - isb
        out[1, i] = measurements.doppler_mps[i] - predicted[i, RATE] - x[X_DRIFT]
        out[2, i] = all_m2 * share + (growth_m * (age_s / 3600.0) ** 2) ** 2
        out[3, i] = sigma.rate_mps**2 / math.sin(max(elevation, 0.1))
        out[4, i] = white_m2 * share if sigma.lasting_s > 0.0 else out[2, i]
        out[5, i], out[6, i] = elevation, predicted[i, DELAY]
        for k in range(3):
            h[i, k] = -predicted[i, LINE_OF_SIGHT + k]
        h[i, CLOCK] = 1.0
        if system > 0:
            h[i, ISB - 1 + system] = 1.0
    return out, h
