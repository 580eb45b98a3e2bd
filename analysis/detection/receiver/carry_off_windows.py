"""Detects a receiver that is carried off slowly, by windows over its past.

A window begins with every fix; its likelihood ratio of a steady carry-off competes with that of a
wrong acceleration, from the IMU or its attitude: both look alike at first and diverge with time.
The equations are in docs/fdi.md, "Slow carry-off".
"""

from typing import NamedTuple

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import ERROR_SIZE, PSI, V
from analysis.detection.filter.information import add_error
from analysis.detection.receiver.position_test import AssessedFix
from analysis.samples.block import Indices
from analysis.samples.sample import Vector

WINDOW_COUNT = 20  # 4 s of fixes at 5 Hz
STRIDE_US = 180_000  # between windows: less than the interval of fixes at 5 Hz
# A window's responses, along or about north, east and down, and how many
CARRIED, ACCELERATED, TURNED, RESPONSES = slice(0, 3), slice(3, 6), slice(6, 9), 9
# Slow errors of a healthy receiver's velocity, four times 0.05 m/s (50 % at 30 m/s: u-blox ZED-F9P
# data sheet, table 1), and of a healthy IMU: 20 mg (ICM-42688-P data sheet, table 2, zero g).
NATURAL_MPS, NATURAL_MPS2 = 0.2, 0.2
LEAST_RATIO_LEAD = 10.0  # of twice the log likelihood, else it is ambiguous: exp(10 / 2), 150 to 1
SETTLED_US = 10_000_000  # after a failed test or impact, whose after-effects look alike
KNOWN_US = 700_000  # age of a window that knows a drag: four epochs at 5 Hz, its sigma is halved
MEMORY_S = 30.0  # of the innovations' level
FIRST_WEIGHT = 10.0  # weight of the assumed noise in the level, in fixes or epochs
LEAST_LEVEL = 0.1  # the best receivers have a third of the assumed sigma
NO_JUMP = np.zeros(3)
POSITION_ROWS = np.arange(3)  # a fix's rows of the position
REGULARIZATION = 1e-9 * np.eye(3)  # makes an axis without information solvable
MOST_SQUARE = 9.0  # a squared innovation counts as at most 3 sigma in the level


class FixInnovation(NamedTuple):
    """A fix and the filter: innovations v (n,), which of north, east, down of position and velocity
    they are (n,), geometry h (n, 20), inverse covariance m (n, n), gain (20, n)."""

    v: Vector
    rows: Indices
    h: Vector
    m: Vector
    gain: Vector


class CarryOffWindows(NamedTuple):
    """The windows over a flight.

    `starts_us` (w,) is when each began (0: not yet), the next one begins at `due_us`; `d` (20, s w)
    are the responses to s = 9 signatures, `c` (w, s) and `j` (w, s, s) the sums, `levels` (w,)
    those of the innovations when a window began. `squares` (6,) are the mean squares of the
    normalized innovations, of `fixes`. At `doubt_us` a finding was made that needs no spoofer, at
    `impact_us` one that needs neither a spoofer nor a faulty IMU.
    """

    due_us: int
    starts_us: Indices
    d: Vector
    c: Vector
    j: Vector
    levels: Vector
    squares: Vector
    fixes: float = FIRST_WEIGHT
    doubt_us: int = -SETTLED_US
    impact_us: int = -SETTLED_US


class CarryOff(NamedTuple):
    """A receiver carried off since `onset_us` with a velocity (3,), after a jump (3,) in m."""

    onset_us: int
    u_ned_mps: Vector
    jump_ned_m: Vector = NO_JUMP


class CarryOffDetection(NamedTuple):
    """A carry-off, how far the filter has followed it d (20,), and the covariance of that."""

    carried: CarryOff
    d: Vector
    covariance: Vector


def new_windows(t_us: int) -> CarryOffWindows:
    """Windows that begin one after the other from `t_us`."""
    w, s = WINDOW_COUNT, RESPONSES
    d, c, j = (np.zeros(shape) for shape in ((ERROR_SIZE, w * s), (w, s), (w, s, s)))
    return CarryOffWindows(t_us, np.zeros(w, np.int64), d, c, j, np.ones(w), np.ones(6))


def fix_innovation(fix: AssessedFix) -> FixInnovation:
    """A fix whose position and velocity were tested."""
    position, velocity, v_ned_mps = fix.position, fix.velocity, fix.measurement.v_ned_mps
    assert velocity is not None
    assert v_ned_mps is not None
    rows = np.concatenate((POSITION_ROWS, 3 + np.flatnonzero(np.isfinite(v_ned_mps))))
    h = np.concatenate((position.h, velocity.h))
    cross = fix.motion.p @ h.T
    variance = np.concatenate((position.variance, velocity.variance))
    m = np.asarray(np.linalg.inv(h @ cross + np.diag(variance)), dtype=float)
    return FixInnovation(np.concatenate((position.v, velocity.v)), rows, h, m, cross @ m)


def extend_windows(
    carry: CarryOffWindows, t_us: int, dt_s: float, phi: Vector, axes: Vector, fix: FixInnovation
) -> CarryOffWindows:
    """Add a fix, `dt_s` after the last, with the transition phi (20, 20) and NED `axes` (3, 3)."""
    d, begun = phi @ carry.d, carry.starts_us > 0
    by_window = d.reshape(ERROR_SIZE, WINDOW_COUNT, RESPONSES)
    # After a few fixes all have begun, and a mask costs more than the addition.
    at = slice(None) if begun.all() else begun
    by_window[0:3, at, ACCELERATED] += 0.5 * dt_s**2 * axes.T[:, None]
    by_window[V : V + 3, at, ACCELERATED] += dt_s * axes.T[:, None]
    by_window[PSI : PSI + 3, at, TURNED] += dt_s * axes.T[:, None]
    e = np.zeros((6, WINDOW_COUNT, RESPONSES))
    ages_s = np.where(begun, (t_us - carry.starts_us) * 1e-6, 0.0)
    for axis in range(3):
        e[axis, :, axis], e[3 + axis, :, axis] = ages_s, begun
    g = e.reshape(6, -1)[fix.rows] - fix.h @ d
    responses = g.reshape(-1, WINDOW_COUNT, RESPONSES)
    weighted = np.einsum("ijk,il->ljk", responses, fix.m)
    c = carry.c + np.einsum("ljk,l->jk", weighted, fix.v)
    j = carry.j + np.einsum("ljk,ljm->jkm", weighted, responses)
    squares, fixes = _level_after(carry, dt_s, fix)
    return carry._replace(d=d + fix.gain @ g, c=c, j=j, squares=squares, fixes=fixes)


def _level_after(carry: CarryOffWindows, dt_s: float, fix: FixInnovation) -> tuple[Vector, float]:
    """Mean squares (6,) of the normalized innovations and their number of fixes, after one more."""
    news = np.minimum(fix.v**2 * np.diag(fix.m), MOST_SQUARE)
    fixes = min(carry.fixes + 1.0, max(MEMORY_S / dt_s, 1.0))
    squares = carry.squares.copy()
    squares[fix.rows] += (news - squares[fix.rows]) / fixes
    return squares, fixes


def renew_oldest_window(carry: CarryOffWindows, t_us: int) -> CarryOffWindows:
    """The windows with the oldest one begun again if one is due."""
    if t_us < carry.due_us:
        return carry
    oldest = int(carry.starts_us.argmin())
    starts_us, levels = carry.starts_us.copy(), carry.levels.copy()
    d, c, j = carry.d.copy(), carry.c.copy(), carry.j.copy()
    starts_us[oldest], levels[oldest] = t_us, max(float(carry.squares.max()), LEAST_LEVEL)
    d[:, oldest * RESPONSES : (oldest + 1) * RESPONSES] = 0.0
    c[oldest], j[oldest] = 0.0, 0.0
    due_us = t_us + STRIDE_US
    return carry._replace(due_us=due_us, starts_us=starts_us, d=d, c=c, j=j, levels=levels)


def search_windows(
    carry: CarryOffWindows, t_us: int, threshold: float
) -> tuple[CarryOffWindows, CarryOffDetection | None, Vector | None]:
    """Search for a carry-off or a wrong acceleration (3,) in NED beyond chi-square `threshold`."""
    begun = np.flatnonzero(carry.starts_us)
    if not len(begun):
        return carry, None, None
    # The level from before all windows: a carry-off must not raise its own threshold.
    oldest = begun[carry.starts_us[begun].argmin()]
    level = float(carry.levels[oldest])
    ratio, rival = (_ratios(carry, begun, part) / level for part in (CARRIED, ACCELERATED))
    window = begun[ratio.argmax()]
    # The filter's reaction to a wrong acceleration looks like a carry-off.
    wrong_mps2 = None
    if rival.max() > max(threshold, ratio.max() + LEAST_RATIO_LEAD):
        carry = carry._replace(doubt_us=t_us)
        if carry.starts_us[oldest] >= carry.impact_us + SETTLED_US:
            wrong_mps2 = _wrong_acceleration(carry, int(begun[rival.argmax()]), level * threshold)
    tempered = _ratios(carry, np.array([window]), CARRIED, NATURAL_MPS)[0] / level
    clear = tempered > threshold and ratio.max() > rival.max() + LEAST_RATIO_LEAD
    # The receiver is isolated only by windows that all began after the filter has settled.
    if not clear or carry.starts_us[oldest] < carry.doubt_us + SETTLED_US:
        return carry, None, wrong_mps2
    return carry, _carry_off_of(carry, int(window)), None


def compare_windows(carry: CarryOffWindows) -> tuple[float, float, CarryOffDetection | None]:
    """The likelihood ratios of a carry-off and of a faulty IMU, and the carry-off."""
    if not carry.starts_us.any():
        return 0.0, 0.0, None
    window, ratio, rival = _strongest(carry)
    return ratio, rival, _carry_off_of(carry, window)


def _strongest(carry: CarryOffWindows) -> tuple[int, float, float]:
    """The window that shows a carry-off most, its likelihood ratio, and that of a faulty IMU."""
    begun = np.flatnonzero(carry.starts_us)
    ratio, force, rate = (_ratios(carry, begun, part) for part in (CARRIED, ACCELERATED, TURNED))
    rival = max(float(force.max()), float(rate.max()))
    return int(begun[ratio.argmax()]), float(ratio.max()), rival


def find_significant_carry_off(
    carry: CarryOffWindows, t_us: int, level: float, threshold: float
) -> CarryOffDetection | None:
    """A carry-off that no test has shown, if it exceeds the chi-square `threshold` and explains
    more than a faulty IMU. `level` is the mean square of the flight's innovations: the noisier they
    are, the larger are slow errors of a healthy receiver's velocity."""
    window, ratio, rival = _strongest(carry)
    natural = NATURAL_MPS * np.sqrt(level / LEAST_LEVEL)
    tempered = _ratios(carry, np.array([window]), CARRIED, natural)[0]
    clear = tempered > level * threshold and ratio > rival + level * LEAST_RATIO_LEAD
    # If a young window's poor estimate were removed, the rest would stay in the filter.
    clear = clear and t_us - carry.starts_us[window] >= KNOWN_US
    return _carry_off_of(carry, window) if clear else None


def _carry_off_of(carry: CarryOffWindows, window: int) -> CarryOffDetection:
    """The carry-off that a window shows."""
    covariance = np.linalg.inv(carry.j[window, CARRIED, CARRIED] + REGULARIZATION)
    d = carry.d[:, window * RESPONSES : window * RESPONSES + 3]
    u = covariance @ carry.c[window, CARRIED]
    return CarryOffDetection(CarryOff(int(carry.starts_us[window]), u), d @ u, d @ covariance @ d.T)


def _wrong_acceleration(carry: CarryOffWindows, window: int, threshold: float) -> Vector | None:
    """The most likely wrong acceleration (3,) of a window, if it exceeds a healthy IMU's errors."""
    ratio = _ratios(carry, np.array([window]), ACCELERATED, NATURAL_MPS2)[0]
    if ratio <= threshold:
        return None
    information = carry.j[window, ACCELERATED, ACCELERATED] + REGULARIZATION
    return np.asarray(np.linalg.solve(information, carry.c[window, ACCELERATED]))


def _ratios(carry: CarryOffWindows, windows: Indices, part: slice, natural: float = 0.0) -> Vector:
    """The likelihood ratios of three of the responses of windows (n,)."""
    c, j = carry.c[windows, part], carry.j[windows, part, part]
    spread = (j + natural**2 * j @ j if natural else j) + REGULARIZATION
    return np.asarray(np.einsum("ij,ij->i", c, np.linalg.solve(spread, c[..., None])[..., 0]))


def remove_carry_off(motion: MotionEstimate, detection: CarryOffDetection) -> MotionEstimate:
    """The filter as if the receiver had not been used since its carry-off began."""
    x = add_error(motion.x, -detection.d)
    return motion._replace(x=x, p=motion.p + detection.covariance)


def fits_carry_off(carried: CarryOff, t_us: int, fix: FixInnovation) -> bool:
    """Whether a fix is closer to where it would have been carried off to by now than to the filter,
    which becomes uncertain without a receiver."""
    age_s = (t_us - carried.onset_us) * 1e-6
    away_m = carried.jump_ned_m + carried.u_ned_mps * age_s
    v = fix.v - np.concatenate((away_m, carried.u_ned_mps))[fix.rows]
    return float(v @ fix.m @ v) < float(fix.v @ fix.m @ fix.v)
