"""An epoch's ranges and rates: the table of its satellites, and whitened rows."""

from typing import NamedTuple

import numpy as np

from analysis.detection.filter.inertial import X_CLOCK, X_DRIFT, V
from analysis.detection.filter.measurement import (
    EpochObservation,
    Indices,
    compare_with_prediction,
)
from analysis.detection.filter.range_noise import SigmaModel
from analysis.orbits.broadcast import CLOCK as SAT_CLOCK
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS, SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.linear import invert_positive_definite

# Columns of the satellite table: range and rate corrected for delays, satellite clock and satellite
# motion; range less the distance from the filter's position; sigmas; line of sight; innovations
# over the detector's sigmas; whether it is above the elevation mask.
CORRECTED, RATE, RESIDUAL, SIGMA, RATE_SIGMA, LOS, NORMALISED, ABOVE_MASK = 0, 1, 2, 3, 4, 5, 8, 10
COLUMNS = 11
# Columns of a row: rotation and translation of the pose, velocity, clock, drift, right side.
SHIFT, VELOCITY, CLOCK, DRIFT, RIGHT_SIDE, ROW = 3, 6, 9, 10, 11, 12


def range_table(
    observation: EpochObservation,
    x: Vector,
    ionosphere: Vector,
    sigma: SigmaModel,
    correlation: float,
    mask_rad: float,
) -> Vector:
    """The table (n, COLUMNS) of an epoch's satellites at the filter's state x (21,)."""
    states = observation.satellite_states
    innovations = compare_with_prediction(observation.measurements, states, x, ionosphere, sigma)
    out = np.empty((len(states), COLUMNS))
    los = -innovations.geometry[:, :3]
    sagnac = (states[:, 0] * x[1] - states[:, 1] * x[0]) * GNSS_EARTH_RATE_RPS / SPEED_OF_LIGHT_MPS
    distance = np.linalg.norm(states[:, :3] - x[:3], axis=1) + sagnac - states[:, SAT_CLOCK]
    white, rate_sigma = np.sqrt(innovations.variance), np.sqrt(innovations.rate_variance)
    out[:, LOS : LOS + 3] = los
    out[:, RESIDUAL] = innovations.range_m + x[X_CLOCK]
    out[:, CORRECTED] = out[:, RESIDUAL] + distance
    out[:, RATE] = innovations.rate_mps + x[X_DRIFT] - los @ x[V : V + 3]
    out[:, SIGMA], out[:, RATE_SIGMA] = correlation * white, rate_sigma
    out[:, NORMALISED] = innovations.range_m / white
    out[:, NORMALISED + 1] = innovations.rate_mps / rate_sigma
    out[:, ABOVE_MASK] = innovations.elevation_rad >= mask_rad
    return out


class NodeState(NamedTuple):
    """Linearisation point of the rows: pose (4, 4), velocity (3,) in m/s, clock in m and m/s."""

    pose: Vector
    velocity: Vector
    clock_m: float
    drift_mps: float


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
    used = weights > 0.0
    of_ranges = np.flatnonzero(used & ranges)
    of_rates = np.flatnonzero(used & doppler & np.isfinite(table[:, RATE]))
    out, count = np.zeros((len(of_ranges) + len(of_rates), ROW)), len(of_ranges)
    # The root: information is proportional to the weight.
    share = np.sqrt(weights[of_ranges]) / table[of_ranges, SIGMA]
    los = share[:, None] * (table[of_ranges, LOS : LOS + 3] @ axes.T)
    out[:count, SHIFT:VELOCITY], out[:count, CLOCK] = -los @ at.pose[:3, :3], share
    residual = table[of_ranges, RESIDUAL] - at.clock_m
    out[:count, RIGHT_SIDE] = share * residual + los @ ahead_m
    share = np.sqrt(weights[of_rates]) / table[of_rates, RATE_SIGMA]
    los = share[:, None] * (table[of_rates, LOS : LOS + 3] @ axes.T)
    out[count:, VELOCITY:CLOCK], out[count:, DRIFT] = -los, share
    residual = table[of_rates, RATE] - at.drift_mps
    out[count:, RIGHT_SIDE] = share * residual + los @ at.velocity
    return out


def snapshot_covariance(table: Vector, weights: Vector, system: Indices, share: float) -> Vector:
    """Covariance (3, 3) in ECEF of a snapshot solution with a clock per system from the satellites
    with a weight, their sigmas multiplied by `share`; NaN if undetermined."""
    used = weights > 0.0
    # Only for systems in use: an unobserved clock would make the matrix singular.
    clocks = system[used][:, None] == np.unique(system[used])
    rows = np.hstack([table[used, LOS : LOS + 3], clocks]) / (share * table[used, SIGMA])[:, None]
    # With fewer satellites than unknowns rounding may still leave the matrix invertible.
    if rows.shape[0] < rows.shape[1]:
        return np.full((3, 3), np.nan)
    return invert_positive_definite(rows.T @ rows)[:3, :3]
