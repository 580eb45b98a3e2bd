"""Scores of attitude estimators against the truth that is sent beside the sensor frames.

Each estimate waits for the truth samples before and after it and is compared with the truth
interpolated between them; one that comes up to a second late, as from an autopilot on a link, still
counts. NaN counts as an error of 180 degrees. Errors are collected in time bins of `1 / rate_hz`:
sums at the full rate of the estimates for the scores, the first error of each bin as a result.
Invalid IMU, magnetometer and airspeed samples (NaN, 1e20) are not passed to estimators.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from analysis.estimators import Estimator, Prior, estimate_block, make_estimator
from analysis.results import AttitudeError
from analysis.samples.block import (
    AIRSPEED,
    ATTITUDE,
    ATTITUDE_SOURCE,
    IMU,
    IMU_ID,
    MAG,
    SOURCES,
    TRUTH,
    WIDTH,
    Block,
    Indices,
    Stamps,
)
from analysis.samples.sample import IMU_VALUE_LIMIT, Sample, TruthSample, Vector
from analysis.scoring.attitude_kernel import ScoredEstimates, score_estimates
from analysis.scoring.attitude_scores import (
    ErrorBins,
    flight_phases,
    score_breakdown,
)
from mavproxy_fault.numerics.magnetic_field import date_of, magnetic_field_gauss
from mavproxy_fault.wire.label import Label

MAX_WAITING = 20_000  # estimates, to bound memory while the truth pauses; the oldest are dropped
# The messages in which an autopilot reports its attitude, in the order of `SOURCES`.
AUTOPILOTS = ("ATTITUDE", "ATTITUDE_QUATERNION")
FIRST_AUTOPILOT = SOURCES.index(AUTOPILOTS[0])


class AttitudeConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which estimators run; `imu` is the id of the IMU they use, `settle_s` at the start is not
    scored.

    `declination_deg` None takes it from the World Magnetic Model at the first true position,
    on the day of its stamp, or on 1 January 2025 where the stamps count from boot.
    """

    estimators: tuple[str, ...] = ("ekf",)
    rate_hz: Annotated[float, Meta(gt=0, le=1000)] = 10.0
    imu: Annotated[int, Meta(ge=0, le=255)] = 0
    settle_s: Annotated[float, Meta(ge=0)] = 0.0
    declination_deg: float | None = None


class Estimates(NamedTuple):
    """Estimates (n,): row of the block, index of the source, stamp, and q_nb (n, 4)."""

    row: Indices
    source: Indices
    t_us: Stamps
    q_nb: Vector

    def at(self, rows: Indices) -> "Estimates":
        """The estimates at some indices (m,)."""
        return Estimates(
            self.row[rows], self.source[rows], self.t_us[rows], self.q_nb.take(rows, axis=0)
        )


NO_ESTIMATES = Estimates(
    np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 4))
)


@dataclass
class ScorerState:
    """State of the scorer, changed in place; `bins` grows with every block.

    `last_us` is the start of the newest bin of each source; `truth_us` (k,) and `truth` (k, WIDTH)
    are the newest truths.
    """

    last_us: dict[str, int] = field(default_factory=dict)
    t0_us: int | None = None
    estimators: dict[str, Any] = field(default_factory=dict)
    truth_us: Stamps = field(default_factory=lambda: np.empty(0, np.int64))
    truth: Vector = field(default_factory=lambda: np.empty((0, WIDTH)))
    waiting: Estimates = NO_ESTIMATES
    bins: dict[str, list[ErrorBins]] = field(default_factory=dict)  # one entry per block


class AttitudeScorer:
    """A step of the pipeline; scoring starts at the first truth sample."""

    def __init__(self, config: AttitudeConfig) -> None:
        self.config = config
        self._estimators: dict[str, Estimator] = {
            name: make_estimator(name) for name in config.estimators
        }
        self._names = (*self._estimators, *AUTOPILOTS)
        self._bin_us = round(1e6 / config.rate_hz)

    def new_state(self) -> ScorerState:
        """The state before the first sample."""
        return ScorerState()

    def step(
        self, block: Block, state: ScorerState
    ) -> tuple[list[tuple[int, AttitudeError]], ScorerState]:
        """Score a block of samples: the errors thinned to `rate_hz`, each with the row of the block
        that completed it, and the next state."""
        truths = block.rows(TRUTH)
        begin = -1
        if state.t0_us is None:
            if not len(truths):
                return [], state
            begin = int(truths[0])
            self._start(block.sample(begin), state)
        estimates = self._estimates(block, begin, state)
        truth_us = np.concatenate([state.truth_us, block.t_us[truths]])
        truth = np.concatenate([state.truth, block.values.take(truths, axis=0)])
        truth_row = np.concatenate([np.full(len(state.truth_us), -1), truths])
        of_estimates = estimates.row, estimates.t_us, estimates.q_nb
        scored, waiting, oldest = score_estimates(truth_row, truth_us, truth, *of_estimates)
        # The newest; the truth for older ones is no longer kept.
        waiting = waiting[-MAX_WAITING:]
        state.waiting = estimates.at(waiting)._replace(row=np.full(len(waiting), -1))
        # Copies, or a slice would keep the entire block alive.
        state.truth_us, state.truth = truth_us[oldest:].copy(), truth[oldest:].copy()
        return self._gather(state, estimates.at(scored.estimator_index), scored, truth), state

    def _start(self, sample: Sample, state: ScorerState) -> None:
        assert isinstance(sample, TruthSample)
        state.t0_us = sample.t_us
        place = sample.lat_deg, sample.lon_deg, sample.alt_m
        if self.config.declination_deg is None:
            declination = declination_rad(*place, sample.t_us)
        else:
            declination = math.radians(self.config.declination_deg)
        prior = Prior(sample.t_us, sample.q_nb, sample.v_ned_mps, declination_rad=declination)
        state.estimators = {name: e.start(prior) for name, e in self._estimators.items()}

    def _estimates(self, block: Block, begin: int, state: ScorerState) -> Estimates:
        """Waiting estimates and the block's estimates after row `begin`, in order."""
        rows = np.arange(begin + 1, len(block.kind))
        block = block.between(begin + 1, len(block.kind))
        # Estimators see one IMU, as a flight controller's estimator instance does.
        of_imu = (block.kind != IMU) | (block.values[:, IMU_ID] == self.config.imu)
        valid = of_imu & _measurement_rows(block)
        used = block if valid.all() else block.where(valid)
        imu = rows[valid & (block.kind == IMU)]
        collected = [state.waiting]
        for number, (name, estimator) in enumerate(self._estimators.items()):
            t_us, q_nb, state.estimators[name] = estimate_block(
                estimator, used, state.estimators[name]
            )
            collected.append(Estimates(imu, np.full(len(imu), number), t_us, q_nb))
        own = np.flatnonzero(valid & (block.kind == ATTITUDE))
        source = block.values[own, ATTITUDE_SOURCE].astype(np.int64)
        number = source - FIRST_AUTOPILOT + len(self._estimators)
        collected.append(Estimates(rows[own], number, block.t_us[own], block.values[own, :4]))
        every = Estimates(*(np.concatenate(column) for column in zip(*collected, strict=True)))
        # Stable: within one row our own come first, in the configured order.
        return every.at(np.argsort(every.row, kind="stable"))

    def _gather(
        self,
        state: ScorerState,
        estimates: Estimates,
        scored: ScoredEstimates,
        truth: Vector,
    ) -> list[tuple[int, AttitudeError]]:
        """Add errors to their bins; returns those that opened a bin, with their row.

        `truth` (k, WIDTH) are the truths to which `scored` refers.
        """
        _, row, after, error = scored
        assert state.t0_us is not None
        since_us = estimates.t_us - state.t0_us
        settled = np.flatnonzero(since_us >= self.config.settle_s * 1e6)
        if len(settled) < len(since_us):
            estimates, error, row = estimates.at(settled), error[settled], row[settled]
            since_us, after = since_us[settled], after[settled]
        if not len(error):
            return []
        # Bins count from the first truth, so they shift if a log is cut elsewhere.
        bin_us = estimates.t_us - since_us % self._bin_us
        numbers = np.hstack([np.ones((len(error), 1)), error**2, np.abs(error)])
        opened = [np.empty(0, np.int64)]
        for number, name in enumerate(self._names):
            own = np.flatnonzero(estimates.source == number)
            if not len(own):
                continue
            known = state.bins.setdefault(name, [])
            changes = np.diff(bin_us[own], prepend=state.last_us.get(name, -1)) != 0
            state.last_us[name] = int(bin_us[own[-1]])
            begins = np.flatnonzero(changes | (np.arange(len(own)) == 0))
            counts = np.add.reduceat(numbers[own, :5], begins)
            sums = np.hstack([counts, np.maximum.reduceat(numbers[own, 5:], begins)])
            if not changes[0]:
                # The bin that was open at the end of the last block has grown in this one.
                last, grown = known[-1].sums[-1], sums[0]
                last[:5], last[5:] = last[:5] + grown[:5], np.maximum(last[5:], grown[5:])
                begins, sums = begins[1:], sums[1:]
            if len(begins):
                first = own[begins]
                true = truth[after[first]]
                phases = flight_phases(true[:, :4], true[:, 10:13])
                known.append(ErrorBins(bin_us[first], phases, sums, error[first]))
                opened.append(first)
        rows = np.sort(np.concatenate(opened))
        return self._results(estimates.at(rows), error[rows], row[rows])

    def _results(
        self, estimates: Estimates, error: Vector, row: Indices
    ) -> list[tuple[int, AttitudeError]]:
        columns = row, estimates.source, estimates.t_us, np.degrees(error)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return [
            (at, AttitudeError(t_us=t_us, estimator=self._names[number], roll=off[0], pitch=off[1],
                               yaw=off[2], angle=off[3]))
            for at, number, t_us, off in rows
        ]  # fmt: skip

    def summary(self, state: ScorerState, labels: Sequence[Label] = ()) -> dict[str, Any]:
        """Scores by estimator, as `score_breakdown` gives them."""
        return {
            name: score_breakdown(
                ErrorBins(*map(np.concatenate, zip(*bins, strict=True))), labels, self._bin_us
            )
            for name, bins in sorted(state.bins.items())
            if bins
        }


def _measurement_rows(block: Block) -> NDArray[np.bool_]:
    """Mask (n,) of valid measurements: not NaN and within the sensor's range."""
    valid = np.ones(len(block.kind), bool)
    for kind, width, most in ((IMU, 6, IMU_VALUE_LIMIT), (MAG, 3, np.inf), (AIRSPEED, 1, np.inf)):
        rows = block.rows(kind)
        # Written so that NaN is invalid too.
        valid[rows] = (np.abs(block.values[rows, :width]) < most).all(axis=1)
    return valid


def declination_rad(lat_deg: float, lon_deg: float, alt_m: float, stamp_us: int) -> float:
    """Magnetic declination on the day of a stamp, as `date_of` reads it."""
    north, east, _ = magnetic_field_gauss(lat_deg, lon_deg, alt_m, date_of(stamp_us))
    return float(np.arctan2(east, north))
