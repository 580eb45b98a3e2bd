"""The receiver's least squares, as compiled functions."""

from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.earth_kernel import geodetic_of, ned_axes
from simvehicle.gnss.pseudorange import (
    DELAY,
    LINE_OF_SIGHT,
    RANGE,
    RANGE_RATE,
    SAT_CLOCK,
    SAT_CLOCK_RATE,
    SAT_ELEVATION,
    signal_geometry,
)

Vector = NDArray[np.float64]

ITERATIONS_MAX = 12
CONVERGED_M = 1e-4  # chosen: far below any measurement error
SMALL_STEP_M = 10.0  # the linearisation is valid over such a step
ZENITH_SIGMA_M = 0.5  # assumed pseudorange error at the zenith
SINE_MIN = 0.05  # of 3 degrees, the lowest elevation of the atmospheric models
PIVOT_MIN = 1e-12  # of the largest element; below it the matrix counts as singular

# Layout of the solution
FIRST_CLOCK = 3  # index among the unknowns, after the position
STATUS, POSITION, CLOCK, VELOCITY, DRIFT, SIGMA, GEODETIC, VELOCITY_NED = 0, 1, 4, 6, 9, 10, 13, 16
SOLUTION_SIZE = 19
SOLVED, SINGULAR, DIVERGED = 0.0, 1.0, 2.0


@compiled
def invert_matrix(matrix: Vector) -> Vector:
    """Invert a small positive definite matrix (m, m) by Gauss-Jordan; empty if singular.

    Loops instead of slices, here and below, compile in a fraction of the time.
    """
    m = len(matrix)
    work, out = np.empty((m, m)), np.zeros((m, m))
    floor = 0.0
    for j in range(m):
        out[j, j] = 1.0
        for i in range(m):
            work[j, i] = matrix[j, i]
            floor = max(floor, PIVOT_MIN * abs(matrix[j, i]))
    for k in range(m):
        pivot = work[k, k]
        # Negated, so that NaN counts as singular, too.
        if not pivot > floor:
            return np.empty((0, 0))
        for i in range(m):
            work[k, i] /= pivot
            out[k, i] /= pivot
        for j in range(m):
            factor = work[j, k]
            if j != k:
                for i in range(m):
                    work[j, i] -= factor * work[k, i]
                    out[j, i] -= factor * out[k, i]
    return out


@compiled
def least_squares(
    design: Vector, residual: Vector, weights: Vector, m: int
) -> tuple[Vector, Vector]:
    """Weighted solution (m,) for the first m columns of `design`, and its covariance (m, m).

    Both are empty without full rank.
    """
    n = len(design)
    normal, right = np.zeros((m, m)), np.zeros(m)
    for i in range(n):
        for a in range(m):
            weighted = weights[i] * design[i, a]
            right[a] += weighted * residual[i]
            for b in range(m):
                normal[a, b] += weighted * design[i, b]
    covariance = invert_matrix(normal)
    step = np.zeros(len(covariance))
    for a in range(len(covariance)):
        for b in range(m):
            step[a] += covariance[a, b] * right[b]
    return step, covariance


class ReceiverObservations(NamedTuple):
    """A receiver's observations of n satellites in one epoch.

    `table` (n, 20) holds the orbits, `system` (n,) the index of each satellite's clock, `code_m`
    (n,) the pseudoranges and `rate_mps` (n,) the range rates.
    """

    table: Vector
    system: NDArray[np.int64]
    code_m: Vector
    rate_mps: Vector


@compiled
def solve_navigation(
    observed: ReceiverObservations,
    tow_s: float,
    coefficients: Vector,
    troposphere: bool,
    start: Vector,
    near: bool,
    known_height: tuple[float, float],
) -> Vector:
    """Solve for position, velocity and clocks of one epoch.

    `start` (3 + m,) is the initial position and clock offsets [m]; `near` says that it is within
    some kilometres, so that elevations are valid. `known_height` is an assumed height [m] and its
    standard deviation, for one satellite too few, or NaN. Returns a solution (19,) in the layout
    above; the other arguments are as in `receiver.solve_receiver_fix`.
    """
    table = observed.table
    n, m = len(table), len(start)
    rows = n if np.isnan(known_height[0]) else n + 1
    out = np.zeros(SOLUTION_SIZE)
    x = np.zeros(m)
    for a in range(m):
        x[a] = start[a]
    weights, residual = np.ones(rows), np.zeros(rows)
    design, still = np.zeros((rows, m)), np.zeros(3)
    for _ in range(ITERATIONS_MAX):
        own_s = tow_s - x[FIRST_CLOCK] / SPEED_OF_LIGHT_MPS
        geometry = signal_geometry(table, own_s, x, still, coefficients, troposphere)
        _linearise(observed, geometry, x, design, residual)
        for i in range(n if near else 0):
            # Errors grow towards the horizon roughly with the inverse sine of the elevation.
            weights[i] = (max(sin(geometry[SAT_ELEVATION, i]), SINE_MIN) / ZENITH_SIGMA_M) ** 2
        if rows > n:
            _fill_height_row(known_height, x, design, residual)
            weights[n] = 1.0 / known_height[1] ** 2 if near else 1.0
        step, covariance = least_squares(design, residual, weights, m)
        if len(step) == 0:
            out[STATUS] = SINGULAR
            return out
        size = 0.0
        for a in range(m):
            x[a] += step[a]
            size = max(size, abs(step[a]))
        if near and size < SMALL_STEP_M:
            break
        # The first iterations are unweighted, as elevations need a position.
        near = near or size < CONVERGED_M
    else:
        out[STATUS] = DIVERGED
        return out
    for a in range(m):
        out[POSITION + a] = x[a]  # and the clocks
    _add_velocity(out, geometry, observed.rate_mps, design, weights)
    _add_local(out, covariance)
    return out


@compiled
def _linearise(
    observed: ReceiverObservations, geometry: Vector, x: Vector, design: Vector, residual: Vector
) -> None:
    """Fill in the n pseudorange rows of the design matrix and the residuals."""
    for i in range(len(observed.code_m)):
        clock_at = FIRST_CLOCK + observed.system[i]
        # Moving towards the satellite shortens the range.
        for a in range(3):
            design[i, a] = -geometry[LINE_OF_SIGHT + a, i]
        design[i, clock_at] = 1.0
        model_m = geometry[RANGE, i] - SPEED_OF_LIGHT_MPS * geometry[SAT_CLOCK, i]
        residual[i] = observed.code_m[i] - (model_m + geometry[DELAY, i] + x[clock_at])


@compiled
def _fill_height_row(
    known_height: tuple[float, float], x: Vector, design: Vector, residual: Vector
) -> None:
    """Fill in the last row with the assumed height as a measurement."""
    lat, lon, height = geodetic_of(x[0], x[1], x[2])
    design[-1, 0] = cos(lat) * cos(lon)
    design[-1, 1] = cos(lat) * sin(lon)
    design[-1, 2] = sin(lat)
    residual[-1] = known_height[0] - height


@compiled
def _add_velocity(
    out: Vector, geometry: Vector, rate_mps: Vector, design: Vector, weights: Vector
) -> None:
    """Solve for velocity and drift from range rates; changes `design` to a single clock.

    With an assumed height the vertical velocity is assumed zero.
    """
    residual = np.zeros(len(design))
    for i in range(len(rate_mps)):
        residual[i] = (
            rate_mps[i] - geometry[RANGE_RATE, i] + SPEED_OF_LIGHT_MPS * geometry[SAT_CLOCK_RATE, i]
        )
        design[i, FIRST_CLOCK] = 1.0
    # A literal 4 would make numba compile `least_squares` again for that literal type.
    motion, _ = least_squares(design, residual, weights, 1 + DRIFT - VELOCITY)
    for a in range(len(motion)):
        out[VELOCITY + a] = motion[a]  # and the drift


@compiled
def _add_local(out: Vector, covariance: Vector) -> None:
    """Fill in the geodetic position, and velocity and standard deviations in NED."""
    lat, lon, height = geodetic_of(out[POSITION], out[POSITION + 1], out[POSITION + 2])
    out[GEODETIC], out[GEODETIC + 1], out[GEODETIC + 2] = lat, lon, height
    axes = ned_axes(lat, lon)
    for a in range(3):
        variance = 0.0
        for i in range(3):
            out[VELOCITY_NED + a] += axes[a, i] * out[VELOCITY + i]
            for j in range(3):
                # Only the diagonal of the rotated covariance is needed.
                variance += axes[a, i] * covariance[i, j] * axes[a, j]
        out[SIGMA + a] = sqrt(max(variance, 0.0))
