"""Compiled code for an epoch's ranges and rates: the table of its satellites, and whitened rows."""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.inertial import X_CLOCK, X_DRIFT, V
from analysis.detection.filter.measurement import (
    EpochMeasurements,
    Indices,
    innovations_kernel,
    transmitting_states,
)
from analysis.detection.filter.range_noise import SigmaNumbers
from analysis.orbits.broadcast import CLOCK as SAT_CLOCK
from analysis.orbits.broadcast import CLOCKS
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS, SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.linear import invert_positive_definite

# Columns of the satellite table: range and rate corrected for delays, satellite clock and satellite
# motion; range less the distance from the filter's position; sigmas; line of sight; innovations
# over the detector's sigmas; whether it is above the elevation mask.
CORRECTED, RATE, RESIDUAL, SIGMA, RATE_SIGMA, LOS, NORMALISED, ABOVE_MASK = 0, 1, 2, 3, 4, 5, 8, 10
COLUMNS = 11
# Columns of a row: rotation and translation of the pose, velocity, clock, drift, right side.
SHIFT, VELOCITY, CLOCK, DRIFT, RIGHT_SIDE, ROW = 3, 6, 9, 10, 11, 12


@compiled
def range_table(
    measurements: EpochMeasurements,
    x: Vector,
    ionosphere: Vector,
    sigma: SigmaNumbers,
    correlation: float,
    mask_rad: float,
) -> Vector:
    """The table (n, COLUMNS) of an epoch's satellites at the filter's state x (21,)."""
    states = transmitting_states(measurements)
    innovations = innovations_kernel(measurements, states, x, ionosphere, sigma)
    out = np.empty((states.shape[0], COLUMNS))
    for i in range(out.shape[0]):
        square, along = 0.0, 0.0
        for k in range(3):
            square += (states[i, k] - x[k]) ** 2
            out[i, LOS + k] = -innovations.geometry[i, k]
            along -= innovations.geometry[i, k] * x[V + k]
        sagnac = (states[i, 0] * x[1] - states[i, 1] * x[0]) * (
            GNSS_EARTH_RATE_RPS / SPEED_OF_LIGHT_MPS
        )
        white = math.sqrt(innovations.variance[i])
        out[i, RESIDUAL] = innovations.range_m[i] + x[X_CLOCK]
        out[i, CORRECTED] = out[i, RESIDUAL] + math.sqrt(square) + sagnac - states[i, SAT_CLOCK]
        out[i, RATE] = innovations.rate_mps[i] + x[X_DRIFT] - along
        out[i, SIGMA] = correlation * white
        out[i, RATE_SIGMA] = math.sqrt(innovations.rate_variance[i])
        out[i, NORMALISED] = innovations.range_m[i] / white
        out[i, NORMALISED + 1] = innovations.rate_mps[i] / out[i, RATE_SIGMA]
        out[i, ABOVE_MASK] = 1.0 if innovations.elevation_rad[i] >= mask_rad else 0.0
    return out


class NodeState(NamedTuple):
    """Linearisation point of the rows: pose (4, 4), velocity (3,) in m/s, clock in m and m/s."""

    pose: Vector
    velocity: Vector
    clock_m: float
    drift_mps: float


@compiled
def whiten_rows(
    table: Vector,
    weights: Vector,
    axes: Vector,
    ahead_m: Vector,
    at: NodeState,
    ranges: bool,
    doppler: bool,
) -> Vector:
    """Rows (k, 12) over their sigmas: pseudoranges if `ranges`, then the rates if `doppler`.

    Columns: pose (6), velocity (3), clock, drift, right side relative to the node. `axes` (3, 3)
    are the frame's; `ahead_m` (3,), in these axes, leads from the table's position to the node.
    """
    out = np.zeros((2 * table.shape[0], ROW))
    line_of_sight = np.empty(3)
    count = 0
    for kind in range(2):
        for i in range(table.shape[0]):
            use = ranges if kind == 0 else doppler and np.isfinite(table[i, RATE])
            if not (use and weights[i] > 0.0):
                continue
            # The root: information is proportional to the weight. RATE_SIGMA follows SIGMA.
            share = math.sqrt(weights[i]) / table[i, SIGMA + kind]
            row = out[count]
            count += 1
            for k in range(3):
                line_of_sight[k] = 0.0
                for j in range(3):
                    line_of_sight[k] += share * axes[k, j] * table[i, LOS + j]
            if kind == 0:
                row[CLOCK], row[RIGHT_SIDE] = share, share * (table[i, RESIDUAL] - at.clock_m)
                for k in range(3):
                    row[RIGHT_SIDE] += line_of_sight[k] * ahead_m[k]
                    for j in range(3):
                        row[SHIFT + k] -= line_of_sight[j] * at.pose[j, k]
            else:
                row[DRIFT], row[RIGHT_SIDE] = share, share * (table[i, RATE] - at.drift_mps)
                for k in range(3):
                    row[VELOCITY + k] = -line_of_sight[k]
                    row[RIGHT_SIDE] += line_of_sight[k] * at.velocity[k]
    return out[:count]


@compiled
def snapshot_covariance(table: Vector, weights: Vector, system: Indices, share: float) -> Vector:
    """Covariance (3, 3) in ECEF of a snapshot solution with a clock per system from the satellites
    with a weight, their sigmas multiplied by `share`; NaN if undetermined."""
    clock, size, count = np.zeros(CLOCKS, np.int64), 3, 0
    for kind in range(CLOCKS):
        before = count
        for i in range(table.shape[0]):
            if weights[i] > 0.0 and system[i] == kind:
                count += 1
        if count > before:
            # Only for systems in use: an unobserved clock would make the matrix singular.
            clock[kind], size = size, size + 1
    normal, row = np.zeros((size, size)), np.zeros(size)
    for i in range(table.shape[0]):
        if not weights[i] > 0.0:
            continue
        row[:] = 0.0
        for k in range(3):
            row[k] = table[i, LOS + k] / (share * table[i, SIGMA])
        row[clock[system[i]]] = 1.0 / (share * table[i, SIGMA])
        for k in range(size):
            for j in range(size):
                normal[k, j] += row[k] * row[j]
    cofactor, out = invert_positive_definite(normal), np.empty((3, 3))
    for k in range(3):
        for j in range(3):
            # With fewer satellites than unknowns rounding may still leave the matrix invertible.
            out[k, j] = cofactor[k, j] if count >= size else np.nan
    return out
