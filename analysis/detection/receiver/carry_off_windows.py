"""A receiver that is carried off slowly: found by its past, as the filter follows it.

A spoofer that takes over at t_0 and drags with velocity u adds u (t - t_0) to the receiver's
position and u to its velocity. What that does to the filter is linear, as in `ramp_windows`: with
H the geometry of position and velocity, e = [(t - t_0) I; I], K the gain and M the inverse
innovation covariance,

    D <- Phi D,   g = e - H D,   c += g' M v,   J += g' M g,   D <- D + K g,

u = inv(J) c is the likeliest carry-off and c' inv(J) c its likelihood ratio, chi-square(3) without
a spoofer. What the filter has followed is D u, and is taken back. As t_0 is unknown, a window
begins with every fix. A sound receiver's velocity is off by something for seconds (variance k), so
it is c' inv(J + k J^2) c that is tested.

A wrong acceleration, the IMU's or by its attitude, has three responses of its own and is the rival:
a step of velocity and one of acceleration look alike at first and grow apart with time. What looks
more like the rival is told as such: it is no receiver that is carried off steadily.

The noise that the filter assumes of a receiver is one that few exceed; most are far better. So the
ratios are taken over the squared innovations that this flight had before the windows began.
"""

from typing import NamedTuple

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import ERROR_SIZE, PSI, V
from analysis.detection.filter.information import Indices, add_error
from analysis.detection.receiver.position_test import FixMeasurement, FixTest
from analysis.samples.sample import Vector

WINDOW_COUNT = 20
STRIDE_US = 180_000  # a window begins with every fix, where those do not come faster
# A window's responses, along or about north, east and down; the last three where they are asked.
CARRIED, ACCELERATED, TURNED = slice(0, 3), slice(3, 6), slice(6, 9)
EACH, WITH_TURNS = 6, 9
# What a sound receiver's velocity and a sound IMU's acceleration are off by for seconds
NATURAL_MPS, NATURAL_MPS2 = 0.2, 0.2
LEAST_RATIO_LEAD = 10.0  # by which a carry-off or its rival must explain more than the other
SETTLED_US = 10_000_000  # in which the filter follows what was a blow or a wrong acceleration
KNOWN_US = 700_000  # that a window lasts before its drag is taken back unasked
MEMORY_S = 30.0  # of the level of the innovations
FIRST_WEIGHT = 10.0  # fixes in favour of the noise as it is assumed
LEAST_LEVEL = 0.1
NO_JUMP = np.zeros(3)
POSITION_ROWS = np.arange(3)  # the rows of a fix that are its position
REGULARIZATION = 1e-9 * np.eye(3)  # keeps an axis without information from dividing by zero
MOST_SQUARE = 9.0  # one outlier says little of the level


class FixInnovation(NamedTuple):
    """A fix against the filter: innovations v (n,), which of north, east, down of the position and
    the velocity they are (n,), geometry h (n, 20), inverse covariance m (n, n), gain (20, n)."""

    v: Vector
    rows: Indices
    h: Vector
    m: Vector
    gain: Vector


class CarryOffWindows(NamedTuple):
    """The windows over a flight.

    `starts_us` (w,) is when each began (0: not yet), the next does at `due_us`; `d` (20, s w) are
    the responses to s = 6 or 9 signatures, `c` (w, s) and `j` (w, s, s) the sums, `levels` (w,)
    those of the innovations when a window began. `squares` (6,) are the normalised innovations'
    mean squares now, of `fixes`. At `doubt_us` something was seen that no spoofer is needed for, at
    `impact_us` something that neither a spoofer nor a wrong IMU is.
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
    """A receiver carried off since `onset_us` with a velocity (3,), from a place that had leapt by
    some metres (3,)."""

    onset_us: int
    u_ned_mps: Vector
    jump_ned_m: Vector = NO_JUMP


class CarryOffDetection(NamedTuple):
    """A carry-off, what the filter has followed of it d (20,), and the covariance of that."""

    carried: CarryOff
    d: Vector
    covariance: Vector


def new_windows(t_us: int, each: int = EACH) -> CarryOffWindows:
    """Windows that begin one after the other from `t_us`; `each` with wrong rates or without."""
    w = WINDOW_COUNT
    table, sums, squares = np.zeros((ERROR_SIZE, w * each)), np.zeros((w, each)), np.ones(6)
    starts_us = np.zeros(w, np.int64)
    return CarryOffWindows(
        t_us, starts_us, table, sums, np.zeros((w, each, each)), np.ones(w), squares
    )


def fix_innovation(
    measured: FixMeasurement, position: FixTest, velocity: FixTest, p: Vector
) -> FixInnovation:
    """A fix whose position and velocity were tested before the covariance p (20, 20)."""
    assert measured.v_ned_mps is not None
    rows = np.concatenate((POSITION_ROWS, 3 + np.flatnonzero(np.isfinite(measured.v_ned_mps))))
    h = np.concatenate((position.h, velocity.h))
    cross = p @ h.T
    variance = np.concatenate((position.variance, velocity.variance))
    m = np.asarray(np.linalg.inv(h @ cross + np.diag(variance)), dtype=float)
    return FixInnovation(np.concatenate((position.v, velocity.v)), rows, h, m, cross @ m)


def extend_windows(
    carry: CarryOffWindows, t_us: int, dt_s: float, phi: Vector, axes: Vector, fix: FixInnovation
) -> CarryOffWindows:
    """One fix more, `dt_s` after the last, with the transition phi (20, 20) between them; `axes`
    (3, 3) are north, east and down in ECEF."""
    d, count = phi @ carry.d, carry.c.shape[1]
    by_window, begun = d.reshape(ERROR_SIZE, WINDOW_COUNT, count), carry.starts_us > 0
    # All have after a few fixes, and a mask costs more than what is added.
    at = slice(None) if begun.all() else begun
    by_window[0:3, at, ACCELERATED] += 0.5 * dt_s**2 * axes.T[:, None]
    by_window[V : V + 3, at, ACCELERATED] += dt_s * axes.T[:, None]
    if count == WITH_TURNS:
        by_window[PSI : PSI + 3, at, TURNED] += dt_s * axes.T[:, None]
    e = np.zeros((6, WINDOW_COUNT, count))
    ages_s = np.where(begun, (t_us - carry.starts_us) * 1e-6, 0.0)
    for axis in range(3):
        e[axis, :, axis], e[3 + axis, :, axis] = ages_s, begun
    g = e.reshape(6, -1)[fix.rows] - fix.h @ d
    each = g.reshape(-1, WINDOW_COUNT, count)
    weighted = np.einsum("ijk,il->ljk", each, fix.m)
    c = carry.c + np.einsum("ljk,l->jk", weighted, fix.v)
    j = carry.j + np.einsum("ljk,ljm->jkm", weighted, each)
    squares, fixes = _level_after(carry, dt_s, fix)
    return carry._replace(d=d + fix.gain @ g, c=c, j=j, squares=squares, fixes=fixes)


def _level_after(carry: CarryOffWindows, dt_s: float, fix: FixInnovation) -> tuple[Vector, float]:
    """Mean squares (6,) of the normalised innovations, and of how many fixes, after one more."""
    news = np.minimum(fix.v**2 * np.diag(fix.m), MOST_SQUARE)
    fixes = min(carry.fixes + 1.0, max(MEMORY_S / dt_s, 1.0))
    squares = carry.squares.copy()
    squares[fix.rows] += (news - squares[fix.rows]) / fixes
    return squares, fixes


def renew_oldest_window(carry: CarryOffWindows, t_us: int) -> CarryOffWindows:
    """The oldest window begun anew where one is due."""
    if t_us < carry.due_us:
        return carry
    oldest = int(carry.starts_us.argmin())
    starts_us, levels = carry.starts_us.copy(), carry.levels.copy()
    d, c, j, each = carry.d.copy(), carry.c.copy(), carry.j.copy(), carry.c.shape[1]
    starts_us[oldest], levels[oldest] = t_us, max(float(carry.squares.max()), LEAST_LEVEL)
    d[:, oldest * each : (oldest + 1) * each] = 0.0
    c[oldest], j[oldest] = 0.0, 0.0
    due_us = t_us + STRIDE_US
    return carry._replace(due_us=due_us, starts_us=starts_us, d=d, c=c, j=j, levels=levels)


def search_windows(
    carry: CarryOffWindows, t_us: int, threshold: float
) -> tuple[CarryOffWindows, CarryOffDetection | None, Vector | None]:
    """What the windows show beyond the chi-square `threshold`: a carry-off, or a wrong acceleration
    (3,) along north, east and down."""
    begun = np.flatnonzero(carry.starts_us)
    if not len(begun):
        return carry, None, None
    # From before any of the windows: what they hold must not excuse itself.
    oldest = begun[carry.starts_us[begun].argmin()]
    level = float(carry.levels[oldest])
    ratio, rival = (_ratios(carry, begun, part) / level for part in (CARRIED, ACCELERATED))
    window = begun[ratio.argmax()]
    # What follows a wrong acceleration, once the filter has learnt it, looks like a carry-off.
    wrong_mps2 = None
    if rival.max() > max(threshold, ratio.max() + LEAST_RATIO_LEAD):
        carry = carry._replace(doubt_us=t_us)
        if carry.starts_us[oldest] >= carry.impact_us + SETTLED_US:
            wrong_mps2 = _wrong_acceleration(carry, int(begun[rival.argmax()]), level * threshold)
    tempered = _ratios(carry, np.array([window]), CARRIED, NATURAL_MPS)[0] / level
    clear = tempered > threshold and ratio.max() > rival.max() + LEAST_RATIO_LEAD
    # Nobody is blamed before the filter has settled and all windows have begun behind that.
    if not clear or carry.starts_us[oldest] < carry.doubt_us + SETTLED_US:
        return carry, None, wrong_mps2
    return carry, _carry_off_of(carry, int(window)), None


def compare_windows(carry: CarryOffWindows) -> tuple[float, float, CarryOffDetection | None]:
    """The likelihood ratios of a carry-off and of an IMU that is wrong, and the carry-off."""
    begun = np.flatnonzero(carry.starts_us)
    if not len(begun):
        return 0.0, 0.0, None
    ratio, force, rate = (_ratios(carry, begun, part) for part in (CARRIED, ACCELERATED, TURNED))
    rival = max(float(force.max()), float(rate.max()))
    return float(ratio.max()), rival, _carry_off_of(carry, int(begun[ratio.argmax()]))


def find_significant_carry_off(
    carry: CarryOffWindows, t_us: int, level: float, threshold: float
) -> CarryOffDetection | None:
    """The carry-off that no test has shown, if it is beyond the chi-square `threshold` and explains
    more than a wrong IMU; `level` is the mean square of the flight's innovations, and the noisier
    they are the more a sound receiver's velocity is off for seconds."""
    begun = np.flatnonzero(carry.starts_us)
    parts = (CARRIED, ACCELERATED, TURNED)
    ratio, force, rate = (_ratios(carry, begun, part) / level for part in parts)
    window = int(begun[ratio.argmax()])
    natural = NATURAL_MPS * np.sqrt(level / LEAST_LEVEL)
    tempered = _ratios(carry, np.array([window]), CARRIED, natural)[0] / level
    rival = max(float(force.max()), float(rate.max()))
    clear = tempered > threshold and ratio.max() > rival + LEAST_RATIO_LEAD
    # What is taken back before a window knows the drag well leaves the filter with the rest.
    clear = clear and t_us - carry.starts_us[window] >= KNOWN_US
    return _carry_off_of(carry, window) if clear else None


def _carry_off_of(carry: CarryOffWindows, window: int) -> CarryOffDetection:
    """The carry-off that a window shows."""
    covariance = np.linalg.inv(carry.j[window, CARRIED, CARRIED] + REGULARIZATION)
    each = carry.c.shape[1]
    d = carry.d[:, window * each : window * each + 3]
    u = covariance @ carry.c[window, CARRIED]
    return CarryOffDetection(CarryOff(int(carry.starts_us[window]), u), d @ u, d @ covariance @ d.T)


def _wrong_acceleration(carry: CarryOffWindows, window: int, threshold: float) -> Vector | None:
    """The likeliest wrong acceleration (3,) of a window, if it is more than a sound IMU's."""
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


def remove_carry_off(motion: MotionEstimate, found: CarryOffDetection) -> MotionEstimate:
    """The filter as if the receiver had not been used since it was carried off."""
    x = motion.x.copy()
    add_error(x, -found.d)
    return motion._replace(x=x, p=motion.p + found.covariance)


def fits_carry_off(carried: CarryOff, t_us: int, fix: FixInnovation) -> bool:
    """Whether a fix lies where it would have been carried to by now rather than where the filter
    is, which without a receiver grows unsure."""
    age_s = (t_us - carried.onset_us) * 1e-6
    away_m = carried.jump_ned_m + carried.u_ned_mps * age_s
    v = fix.v - np.concatenate((away_m, carried.u_ned_mps))[fix.rows]
    return float(v @ fix.m @ v) < float(fix.v @ fix.m @ fix.v)
