"""The other sensors against the navigation filter.

Barometer, airspeed, magnetometer, vision, range, and a receiver's own position and velocity.

While the detector finds the IMU (or at least the satellites) sound, its filter is the reference.
Every sensor is tested at each GNSS epoch with its newest sample: innovation v, what the filter and
the sensor's own slow states (an offset, the wind, the local field) leave uncertain of it, and

    v' inv(H_b P_b H_b' + R) v  against chi-square(m),

with a false-alarm probability of its own (`p_other`). A sensor that fails several times running is
isolated until it has been healthy for `readmit_s`; its slow states stand still meanwhile. How each
is predicted is in `sensor_models`.

`NavigationDetector` contains the detector: its results are the detector's and the sensors'
together, so a pipeline holds either a `Detector` or a `NavigationDetector`.
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
    NEVER_US,
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
from analysis.samples.block import WIDTH, Block, BlockSlice, block_of, split_at_events
from analysis.samples.sample import Sample, Vector

STALE_S = STALE_US * 1e-6  # older samples are not tested
SOUND_FILTER = ("none", "satellites", "clock", "gps")  # hypotheses that leave the filter sound
EpochReference = tuple[
    int, Decision, MotionEstimate | None
]  # a block's row, the decision there, and the filter


@dataclass(frozen=True, slots=True)
class NavigationState:
    """The detector's state and what is kept of the other sensors."""

    detector: DetectorState
    kept: SensorStates


@dataclass(frozen=True)
class NavigationDetector:
    """The detector and the tests of the other sensors against it."""

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
        """Nothing known."""
        count = len(SENSORS)
        counts = np.zeros((count, 4), np.int64)
        counts[:, [SLOW_US, HEALTHY_US]] = NEVER_US
        kept = SensorStates(
            np.full(count, NEVER_US),
            np.zeros((count, WIDTH)),
            counts,
            np.zeros((count, 12)),
            self.sensors.sigmas() ** 2,
            np.full(4, UNTESTED),
            np.zeros(1),
        )
        return NavigationState(self.detector.new_state(), kept)

    def step(
        self, samples: Sample | Block, state: NavigationState
    ) -> tuple[list[Result], NavigationState]:
        """Decisions that a block of samples, or a single one, allows, and the next state."""
        block = samples if isinstance(samples, Block) else block_of(samples)
        found, state = self.step_rows(block, state)
        return [result for _, result in sorted(found, key=itemgetter(0))], state

    def step_rows(
        self, block: Block, state: NavigationState
    ) -> tuple[list[tuple[int, Result]], NavigationState]:
        """The same, each with the row of the block that led to it: the detector's, then others."""
        found: list[tuple[int, Result]] = []
        decided: list[EpochReference] = []
        before, detector = state.detector.core.motion, state.detector

        def wanted(t_us: int) -> bool:
            return self.detector.wants_fix(detector.core, t_us)

        for piece in split_at_events(block, wanted):
            results, detector = self.detector.step_piece(piece, detector)
            found += [(piece.last, result) for result in results]
            decided += _epoch_reference(piece.last, results, detector)
        tested, kept = self._judged(block, decided, before, state.kept)
        return found + tested, NavigationState(detector, kept)

    def step_piece(
        self, piece: BlockSlice, state: NavigationState
    ) -> tuple[list[Result], NavigationState]:
        """The same for samples up to an event, where something else moves the filter meanwhile."""
        results, detector = self.detector.step_piece(piece, state.detector)
        rows = piece.block.between(piece.first, piece.last + 1)
        decided = _epoch_reference(piece.last - piece.first, results, detector)
        tested, kept = self._judged(rows, decided, detector.core.motion, state.kept)
        return [*results, *(result for _, result in tested)], NavigationState(detector, kept)

    def _judged(
        self,
        block: Block,
        decided: Sequence[EpochReference],
        before: MotionEstimate | None,
        kept: SensorStates,
    ) -> tuple[list[tuple[int, Result]], SensorStates]:
        """The sensors' tests at some decisions; `before` is the filter until the first."""
        if not decided and not _OF_SENSORS[block.kind].any():
            return [], kept
        # The kernel changes it in place; the state that was handed in stays as it is.
        kept = kept.copy()
        motions = [_START if m is None else m for m in (before, *(m for _, _, m in decided))]
        decisions = EpochDecisions(
            np.array([_kernel_row(*row) for row in decided], np.int64).reshape(-1, 4),
            np.array([motion.x for motion in motions]),
            np.array([motion.p for motion in motions]),
            np.array([motion.inertial for motion in motions], np.int64),
        )
        rows = BlockRows(block.kind, block.t_us, block.values)
        return _results(
            run_sensor_tests(rows, decisions, kept, self._limits), self._thresholds
        ), kept


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
    """A decision as the kernel takes it."""
    bounded = decision.position_sigma_m is not None
    how = (
        SOUND if motion is not None and decision.hypothesis in SOUND_FILTER and bounded else FAULTY
    )
    # The epoch was untestable, so nothing is predicted to test against.
    if decision.mode == "":
        how = UNTESTED
    return row, decision.t_us, how, decision.mode.startswith("position")


def _results(outcomes: Vector, thresholds: Vector) -> list[tuple[int, Result]]:
    """The kernel's outcomes (k, OUTCOME), by row of the block, in the words of `results`."""
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
