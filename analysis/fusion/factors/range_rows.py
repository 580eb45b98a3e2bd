"""An epoch's ranges and rates in compiled code: the table of its satellites, and whitened rows."""

import math

import numpy as np

from analysis.detection.filter.inertial import X_CLOCK, X_DRIFT, V
from analysis.detection.filter.measurement import Indices, modelled_at
from analysis.orbits.broadcast import EARTH_RATE_RPS, LIGHT_MPS, SYSTEMS, satellite_states
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import inverse

# Columns of the table of a satellite: its range and rate as they would be without delays, satellite
# clock and satellite's motion; the range less what it is from the filter's position; sigmas; line
# of sight; innovations over the detector's sigmas; whether it is above the mask.
CORRECTED, RATE, LEFT, SIGMA, RATE_SIGMA, LOS, NORMALISED, ABOVE = 0, 1, 2, 3, 4, 5, 8, 10
COLUMNS = 11


@compiled
def measured(
    packed: Vector,
    pseudorange_m: Vector,
    doppler_mps: Vector,
    cn0_dbhz: Vector,
    system: Indices,
    week: float,
    tow_s: float,
    x: Vector,
    ionosphere: Vector,
    sigma: Vector,
    correlation: float,
    mask_rad: float,
) -> Vector:
    """The table (n, COLUMNS) of an epoch's satellites."""
    states = satellite_states(packed, week, tow_s, pseudorange_m)
    modelled, h = modelled_at(
        states, pseudorange_m, doppler_mps, cn0_dbhz, system, x, tow_s, ionosphere, sigma
    )
    out = np.empty((states.shape[0], COLUMNS))
    for i in range(out.shape[0]):
        square, along = 0.0, 0.0
        for k in range(3):
            square += (states[i, k] - x[k]) ** 2
            out[i, LOS + k] = -h[i, k]
            along -= h[i, k] * x[V + k]
        turned = (states[i, 0] * x[1] - states[i, 1] * x[0]) * (EARTH_RATE_RPS / LIGHT_MPS)
        white = math.sqrt(modelled[2, i])
        out[i, LEFT] = modelled[0, i] + x[X_CLOCK]
        out[i, CORRECTED] = out[i, LEFT] + math.sqrt(square) + turned - states[i, 6]
        out[i, RATE] = modelled[1, i] + x[X_DRIFT] - along
        out[i, SIGMA], out[i, RATE_SIGMA] = correlation * white, math.sqrt(modelled[3, i])
        out[i, NORMALISED] = modelled[0, i] / white
        out[i, NORMALISED + 1] = modelled[1, i] / out[i, RATE_SIGMA]
        out[i, ABOVE] = 1.0 if modelled[4, i] >= mask_rad else 0.0
    return out


@compiled
def whitened(
    table: Vector,
    weights: Vector,
    r_ecef_m: Vector,
    anchor_m: Vector,
    axes: Vector,
    pose: Vector,
    velocity: Vector,
    clock_m: float,
    drift_mps: float,
    ranges: bool,
    doppler: bool,
) -> Vector:
    """Rows (k, 12) over their sigmas: the pseudoranges where wanted, then the rates.

    Columns: pose (6), velocity (3), clock, drift, and what they should come to from the pose (4, 4)
    and velocity on. The table was made at `r_ecef_m`; anchor and axes are the frame's.
    """
    out = np.zeros((2 * table.shape[0], 12))
    sight, ahead_m = np.empty(3), np.empty(3)
    for k in range(3):
        ahead_m[k] = pose[k, 3]
        for j in range(3):
            ahead_m[k] -= axes[k, j] * (r_ecef_m[j] - anchor_m[j])
    count = 0
    for kind in range(2):
        for i in range(table.shape[0]):
            wanted = ranges if kind == 0 else doppler and np.isfinite(table[i, RATE])
            if not (wanted and weights[i] > 0.0):
                continue
            share = math.sqrt(weights[i]) / table[i, SIGMA + kind]
            row = out[count]
            count += 1
            for k in range(3):
                sight[k] = 0.0
                for j in range(3):
                    sight[k] += share * axes[k, j] * table[i, LOS + j]
            if kind == 0:
                row[9], row[11] = share, share * (table[i, LEFT] - clock_m)
                for k in range(3):
                    row[11] += sight[k] * ahead_m[k]
                    for j in range(3):
                        row[3 + k] -= sight[j] * pose[j, k]
            else:
                row[10], row[11] = share, share * (table[i, RATE] - drift_mps)
                for k in range(3):
                    row[6 + k] = -sight[k]
                    row[11] += sight[k] * velocity[k]
    return out[:count]


@compiled
def snapshot_covariance(table: Vector, weights: Vector, system: Indices, share: float) -> Vector:
    """Covariance (3, 3) in ECEF of a snapshot solution with a clock per system from the satellites
    with a weight, their sigmas multiplied by `share`; NaN where it is undetermined."""
    clock, size, count = np.zeros(len(SYSTEMS), np.int64), 3, 0
    for kind in range(len(SYSTEMS)):
        before = count
        for i in range(table.shape[0]):
            if weights[i] > 0.0 and system[i] == kind:
                count += 1
        if count > before:
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
    cofactor, out = inverse(normal), np.empty((3, 3))
    for k in range(3):
        for j in range(3):
            out[k, j] = cofactor[k, j] if count >= size else np.nan
    return out
