"""Tests the other sensors with the navigation filter: barometer, airspeed, magnetometer, vision,
range, and a receiver's own position and velocity.

While the detector finds the IMU (or at least the satellites) healthy, its filter is the reference.
Every sensor's newest sample is tested at each GNSS epoch, with the innovation v, and the variance
of what the filter and the sensor's own slow states (an offset, the wind, the local field) leave
uncertain:

    v' inv(H_b P_b H_b' + R) v  is compared with chi-square(m),

with a false-alarm probability of its own (`p_other`). A sensor that fails several times in a row is
isolated until it has been healthy for `readmit_s`; its slow states are frozen meanwhile. Each
sensor's prediction is in `sensor_models`.

`NavigationDetector` contains the detector: it returns the results of both.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import itemgetter

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector import Detector
from analysis.detection.detector_state import DetectorState
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import ERROR_SIZE, X_SIZE
from analysis.detection.sensors.sensor_kernel import (
    CODE,
    DECIDED_US,
    DOF,
    FAULTY,
    FIX_OF,
    HEALTHY_US,
    IS_OUT,
    OF_ROW,
    SENSOR,
    SENSOR_OF,
    SLOW_US,
    SOUND,
    STALE_US,
    STATISTIC,
    UNTESTED,
    BlockRows,
    EpochDecisions,
    SensorLimits,
    SensorStates,
    run_sensor_tests,
)
from analysis.detection.sensors.sensor_models import REASONS, SENSORS, TESTED, SensorNoise
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.results import Decision, Result, SensorDecision
from analysis.samples.block import NEVER_US, WIDTH, Block, BlockSlice, block_of, split_at_events
from analysis.samples.sample import Sample, Vector

STALE_S = STALE_US * 1e-6  # older samples are not tested
# hypotheses under which the filter is healthy
SOUND_FILTER = ("none", "satellites", "clock", "gps")
# A block's row, the decision there, and the filter.
EpochReference = tuple[int, Decision, MotionEstimate | None]


@dataclass(frozen=True, slots=True)
class NavigationState:
    """The state of the detector and of the other sensors."""

    detector: DetectorState
    states: SensorStates


@dataclass(frozen=True)
class NavigationDetector:
    """The detector, and the tests of the other sensors with its filter."""

    config: DetectorConfig = field(default_factory=DetectorConfig)
    sensors: SensorNoise = field(default_factory=SensorNoise)

    @cached_property
    def detector(self) -> Detector:
        """The detector whose filter is the reference."""
        return Detector(self.config)

    @cached_property
    def _thresholds(self) -> Vector:
        return np.array(
            [0.0, *(chi_square_threshold(dof, self.config.p_other) for dof in (1, 2, 3))]
        )

    @cached_property
    def _limits(self) -> SensorLimits:
        noise = np.array([self.sensors.sigmas(), self.sensors.walks(), self.sensors.quiet()])
        return SensorLimits(noise, self._thresholds, self.config.readmit_s * 1e6)

    def new_state(self) -> NavigationState:
        """No sample has come yet."""
        count = len(SENSORS)
        counts = np.zeros((count, 4), np.int64)
        counts[:, [SLOW_US, HEALTHY_US]] = NEVER_US
        states = SensorStates(
            np.full(count, NEVER_US),
            np.zeros((count, WIDTH)),
            counts,
            np.zeros((count, 12)),
            self.sensors.sigmas() ** 2,
            np.full(4, UNTESTED),
            np.zeros(1),
        )
        return NavigationState(self.detector.new_state(), states)

    def step(
        self, samples: Sample | Block, state: NavigationState
    ) -> tuple[list[Result], NavigationState]:
        """The results of a block of samples, or a single one, and the next state."""
        block = samples if isinstance(samples, Block) else block_of(samples)
        found, state = self.step_rows(block, state)
        return [result for _, result in sorted(found, key=itemgetter(0))], state

    def step_rows(
        self, block: Block, state: NavigationState
    ) -> tuple[list[tuple[int, Result]], NavigationState]:
        """Results, each with its row of the block: the detector's first, then the sensors'."""
        found: list[tuple[int, Result]] = []
        decided: list[EpochReference] = []
        before, detector = state.detector.core.motion, state.detector

        def wanted(t_us: int) -> bool:
            return self.detector.wants_fix(detector.core, t_us)

        for piece in split_at_events(block, wanted):
            results, detector = self.detector.step_piece(piece, detector)
            found += [(piece.last, result) for result in results]
            decided += _epoch_reference(piece.last, results, detector)
        tested, states = self._judged(block, decided, before, state.states)
        return found + tested, NavigationState(detector, states)

    def step_piece(
        self, piece: BlockSlice, state: NavigationState
    ) -> tuple[list[Result], NavigationState]:
        """The results of samples up to an event, for callers that change the filter in between."""
        results, detector = self.detector.step_piece(piece, state.detector)
        rows = piece.block.between(piece.first, piece.last + 1)
        decided = _epoch_reference(piece.last - piece.first, results, detector)
        tested, states = self._judged(rows, decided, detector.core.motion, state.states)
        return [*results, *(result for _, result in tested)], NavigationState(detector, states)

    def _judged(
        self,
        block: Block,
        decided: Sequence[EpochReference],
        before: MotionEstimate | None,
        states: SensorStates,
    ) -> tuple[list[tuple[int, Result]], SensorStates]:
        """The sensors' tests at some decisions; `before` is the filter until the first."""
        if not decided and not _OF_SENSORS[block.kind].any():
            return [], states
        # The kernel changes a copy in place; the given state is not changed.
        states = states.copy()
        motions = [_START if m is None else m for m in (before, *(m for _, _, m in decided))]
        decisions = EpochDecisions(
            np.array([_kernel_row(*row) for row in decided], np.int64).reshape(-1, 4),
            np.array([motion.x for motion in motions]),
            np.array([motion.p for motion in motions]),
            np.array([motion.inertial for motion in motions], np.int64),
        )
        rows = BlockRows(block.kind, block.t_us, block.values)
        return _results(
            run_sensor_tests(rows, decisions, states, self._limits), self._thresholds
        ), states


_OF_SENSORS = np.array(SENSOR_OF) >= 0  # by kind of sample
_START = MotionEstimate(0, np.zeros(X_SIZE), np.zeros((ERROR_SIZE, ERROR_SIZE)))


def _epoch_reference(
    row: int, results: Sequence[Result], detector: DetectorState
) -> list[EpochReference]:
    """The decision among the results of a row, if any."""
    return [(row, r, detector.core.motion) for r in results if isinstance(r, Decision)][:1]


def _kernel_row(
    row: int, decision: Decision, motion: MotionEstimate | None
) -> tuple[int, int, int, bool]:
    """A decision in the form of the kernel."""
    bounded = decision.position_sigma_m is not None
    how = (
        SOUND if motion is not None and decision.hypothesis in SOUND_FILTER and bounded else FAULTY
    )
    # An untestable epoch has no prediction.
    if decision.mode == "":
        how = UNTESTED
    return row, decision.t_us, how, decision.mode.startswith("position")


def _results(outcomes: Vector, thresholds: Vector) -> list[tuple[int, Result]]:
    """The kernel's outcomes (k, OUTCOME) as results, by row of the block."""
    if not len(outcomes):
        return []
    whole = [OF_ROW, SENSOR, CODE, DOF, DECIDED_US]
    row, sensor, code, dof, t_us = outcomes[:, whole].astype(np.int64).T
    statistics, limits = outcomes[:, STATISTIC], thresholds[dof]
    failed = ~(statistics <= limits)
    columns = (
        row,
        t_us,
        sensor,
        code,
        dof,
        statistics,
        limits,
        failed,
        outcomes[:, IS_OUT] != 0.0,
        outcomes[:, FIX_OF],
    )
    return [
        (
            at,
            SensorDecision(
                t_us=stamp_us,
                sensor=SENSORS[number],
                statistic=statistic if why == TESTED and math.isfinite(statistic) else None,
                threshold=limit if why == TESTED else None,
                dof=freedom,
                alarm=why == TESTED and bad,
                isolated=isolated,
                reason="" if why == TESTED else REASONS[why].format(fix_type=seventh),
            ),
        )
        for at, stamp_us, number, why, freedom, statistic, limit, bad, isolated, seventh in zip(
            *(column.tolist() for column in columns), strict=True
        )
    ]
