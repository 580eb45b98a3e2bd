"""Samples of the compass and the first IMU, and vectors as tuples of floats.

These detectors take a few hundred samples a second, one by one: tuples are ten times as fast as
arrays of three numbers.
"""

import math
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from analysis.detection.detector_registry import RowResults
from analysis.results import SensorDecision
from analysis.samples.block import FIX, IMU, IMU_ID, MAG, Block

Axis = tuple[float, float, float]
ZERO: Axis = (0.0, 0.0, 0.0)  # no field, no turn
State = TypeVar("State")


def compass_samples(block: Block) -> Iterator[tuple[int, int, int, tuple[float, ...]]]:
    """Row, kind, stamp and the first seven numbers of compass, first IMU and fixes."""
    of_imu = (block.kind == IMU) & (block.values[:, IMU_ID] < 0.5)
    rows = np.flatnonzero(of_imu | (block.kind == MAG) | (block.kind == FIX))
    columns = rows.tolist(), block.kind[rows].tolist(), block.t_us[rows].tolist()
    values = zip(*block.values[rows, : IMU_ID + 1].T.tolist(), strict=True)
    return zip(*columns, values, strict=True)


def field_alarms(
    block: Block,
    state: State,
    add_gyro: Callable[[int, Axis, State], None],
    add_field: Callable[[int, Axis, State], SensorDecision | None],
) -> RowResults:
    """Give a detector the samples of gyro and compass in turn, and return its alarms by row."""
    found = []
    for row, kind, t_us, (x, y, z, *_) in compass_samples(block):
        if kind == IMU:
            add_gyro(t_us, (x, y, z), state)
        elif kind == MAG and (alarm := add_field(t_us, (x, y, z), state)):
            found.append((row, alarm))
    return found


def add(a: Axis, b: Axis, share: float = 1.0) -> Axis:
    """Return a plus a share of b."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


def dot(a: Axis, b: Axis) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Axis, b: Axis) -> Axis:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def angle_of(a: Axis, b: Axis) -> float:
    """Return the angle between two directions [rad]."""
    return math.atan2(math.hypot(*cross(a, b)), dot(a, b))
