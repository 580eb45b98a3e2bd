"""Detects sensors that leave their own level, without filter and attitude.

- The size of the magnetic field, whichever way the vehicle points.
- Whether a receiver reports a fix.
"""

from typing import ClassVar

import numpy as np

from analysis.detection.detector_registry import BlockDetector
from analysis.detection.sensors.level_kernel import (
    FIELD,
    HAS_FIX,
    NEWEST,
    LevelState,
    new_levels,
    track_levels,
)
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import FIX, FIX_3D, FIX_TYPE, IMU, IMU_ID, KINDS, MAG, Block, Indices
from analysis.samples.sample import Vector

# A compass averages since its last sample, at most so long; a turn of 0.5 rad reduces it by 1 %
MEAN_US, TURN_RAD = 200_000, 0.5
SENSOR_OF = {FIELD: "mag", HAS_FIX: "gps-position"}
REASONS = {FIELD: "the field's size is off by {:.3f} gauss", HAS_FIX: "reports no fix"}
IN_LEVELS = np.isin(np.arange(len(KINDS)), (MAG, FIX))
Quantities = tuple[int, Indices, Vector]  # of a level: its number, rows of the block, values


class LevelDetector(BlockDetector, frozen=True):
    """Tests the field's size and the fix type."""

    channels: ClassVar = frozenset(SENSOR_OF.values())

    def new_state(self) -> LevelState:
        """No sample has come yet."""
        return new_levels()

    def step(
        self, block: Block, state: LevelState
    ) -> tuple[list[tuple[int, SensorDecision]], LevelState]:
        """The alarms of the next samples by row, and the state, which is changed in place."""
        if not IN_LEVELS[block.kind].any():
            return [], state
        quantities = [_field(block, state), _has_fix(block)]
        row = np.concatenate([rows for _, rows, _ in quantities])
        # By row: the kernel takes the quantities in the order of the samples.
        order = np.argsort(row, kind="stable")
        level = np.concatenate([np.full(len(rows), number) for number, rows, _ in quantities])
        value = np.concatenate([values for *_, values in quantities])
        row, level = row[order], level[order]
        change = track_levels(level, block.t_us[row], value[order], state)
        return [
            (int(row[i]), _result(int(block.t_us[row[i]]), int(level[i]), float(change[i])))
            for i in np.flatnonzero(change)
        ], state


def _field(block: Block, state: LevelState) -> Quantities:
    rows = block.rows(MAG)
    size = np.linalg.norm(block.values[rows, :3], axis=1)
    before_us = np.concatenate([state.stamps[FIELD, [NEWEST]], block.t_us[rows]])[:-1]
    mean_us = np.minimum(block.t_us[rows] - before_us, MEAN_US)
    turned_rad = _rates(block, rows, state) * mean_us * 1e-6
    known = np.isfinite(size) & ~(turned_rad > TURN_RAD)
    return FIELD, rows[known], size[known]


def _rates(block: Block, rows: Indices, state: LevelState) -> Vector:
    """Rates of turn (n,) at some rows, by the newest IMU sample; rad/s."""
    imu = block.rows(IMU)
    imu = imu[block.values[imu, IMU_ID] < 0.5]
    rates = np.linalg.norm(block.values[imu, :3], axis=1)
    known = np.concatenate([state.rate, rates])
    state.rate[0] = known[-1]
    return known[np.searchsorted(imu, rows)]


def _has_fix(block: Block) -> Quantities:
    rows = block.rows(FIX)
    return HAS_FIX, rows, (block.values[rows, FIX_TYPE] >= FIX_3D).astype(float)


def _result(t_us: int, level: int, change: float) -> SensorDecision:
    return pattern_alarm(t_us, SENSOR_OF[level], REASONS[level].format(abs(change)))
