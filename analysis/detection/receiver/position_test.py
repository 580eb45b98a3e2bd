"""Tests a receiver's own position and velocity with the filter, without raw ranges."""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import (
    CLOCK,
    DRIFT,
    ERROR_SIZE,
    X_Q,
    X_SIZE,
    R,
    set_unknown_attitude,
)
from analysis.detection.filter.information import (
    add_error,
    innovation_statistic,
    normal_equations,
    reduce_covariance,
)
from analysis.detection.filter.propagation import Prediction
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.samples.block import FIX_3D
from analysis.samples.sample import GpsFix, Vector
from mavproxy_fault.numerics.earth import ecef_of
from mavproxy_fault.numerics.earth_kernel import ned_axes

POSITION_SIGMA_M = (1.0, 1.5)  # horizontal, vertical: floor of what a receiver reports
UNKNOWN_SIGMA_M = 3.0  # where the receiver reports none
# Horizontal, vertical. Data sheets say 0.05 m/s (as `NATURAL_MPS`), but in steady motion: a
# velocity that is smoothed over 0.1 s errs by 0.3 m/s at 3 m/s^2.
VELOCITY_SIGMA_MPS = (0.3, 0.4)
VELOCITY_VARIANCE = np.array([VELOCITY_SIGMA_MPS[0], *VELOCITY_SIGMA_MPS]) ** 2


class FixMeasurement(NamedTuple):
    """A fix in ECEF: position and variance along north, east, down; velocity where known.

    `v_variance` (3,) is the velocity's, in m^2/s^2.
    """

    r_ecef_m: Vector
    axes: Vector
    variance_m2: Vector
    v_ned_mps: Vector | None
    v_variance: Vector


class FixTest(NamedTuple):
    """One chi-square test; `v`, `h` and `variance` are what an update would use."""

    statistic: float
    threshold: float
    v: Vector
    h: Vector
    variance: Vector

    @property
    def dof(self) -> int:
        """How many components are tested."""
        return len(self.v)

    @property
    def passes(self) -> bool:
        """Whether the fix fits the prediction."""
        return self.statistic <= self.threshold


class AssessedFix(NamedTuple):
    """A fix before any verdict: the filter's prediction, and the tests of position and known
    velocity with it."""

    measurement: FixMeasurement
    prediction: Prediction
    position: FixTest
    velocity: FixTest | None

    @property
    def motion(self) -> MotionEstimate:
        """The predicted filter."""
        return self.prediction.motion

    @property
    def passes(self) -> bool:
        """Whether position and velocity fit the prediction."""
        return self.position.passes and (self.velocity is None or self.velocity.passes)

    def with_motion(self, motion: MotionEstimate, config: FilterConfig) -> "AssessedFix":
        """The fix tested with another state of the filter."""
        tests = run_fix_tests(self.measurement, motion, config)
        return AssessedFix(self.measurement, self.prediction._replace(motion=motion), *tests)


def fix_measurement(fix: GpsFix) -> tuple[FixMeasurement | None, str]:
    """The fix in ECEF, or why it cannot be used."""
    if fix.fix_type < FIX_3D:
        return None, f"fix type {fix.fix_type}; 3 or more is a position"
    if not all(map(math.isfinite, (fix.lat_deg, fix.lon_deg, fix.alt_m))):
        return None, "the position is not finite"
    # Receivers without a position send zeros.
    if fix.lat_deg == 0.0 and fix.lon_deg == 0.0:
        return None, "the position is 0, 0"
    lat, lon = np.radians(fix.lat_deg), np.radians(fix.lon_deg)
    # Reported errors only raise sigma: many receivers are overconfident.
    sigma = [
        max(reported, floor) if math.isfinite(reported) and reported > 0.0 else UNKNOWN_SIGMA_M
        for reported, floor in zip((fix.eph_m, fix.epv_m), POSITION_SIGMA_M, strict=True)
    ]
    variance = np.array([sigma[0], sigma[0], sigma[1]]) ** 2
    r_ecef_m = np.array(ecef_of(lat, lon, np.asarray(fix.alt_m)))
    axes = ned_axes(float(lat), float(lon))
    return FixMeasurement(r_ecef_m, axes, variance, fix.v_ned_mps, VELOCITY_VARIANCE), ""


def run_fix_tests(
    fix: FixMeasurement, motion: MotionEstimate, config: FilterConfig
) -> tuple[FixTest, FixTest | None]:
    """Test the position, and the velocity if known, with the prediction."""
    h = np.zeros((3, ERROR_SIZE))
    h[:, 0:3] = fix.axes
    v = fix.axes @ (fix.r_ecef_m - motion.x[0:3])
    position = _fix_test(motion.p, v, h, fix.variance_m2, config.p_false_alarm)
    if fix.v_ned_mps is None:
        return position, None
    finite = np.isfinite(fix.v_ned_mps)
    if not finite.any():
        return position, None
    h = np.zeros((3, ERROR_SIZE))
    h[:, 3:6] = fix.axes
    v = fix.v_ned_mps - fix.axes @ motion.x[3:6]
    variance = fix.v_variance
    # Selecting all of them takes as long as the test.
    if not finite.all():
        v, h, variance = v[finite], h[finite], variance[finite]
    return position, _fix_test(motion.p, v, h, variance, config.p_other)


def _fix_test(p: Vector, v: Vector, h: Vector, variance: Vector, p_false_alarm: float) -> FixTest:
    q = innovation_statistic(p, normal_equations(h, variance, v, variance))
    return FixTest(q, chi_square_threshold(len(v), p_false_alarm), v, h, variance)


def update_with_fix(motion: MotionEstimate, part: FixTest) -> MotionEstimate:
    """Return the filter updated with the part of the fix that a test used."""
    normal = normal_equations(part.h, part.variance, part.v, part.variance)
    p, _, moved = reduce_covariance(motion.p, normal)
    return motion._replace(x=add_error(motion.x, moved), p=p)


def known_or_zero(v: Vector) -> Vector:
    """A velocity (3,) with unknown components, which are rare, set to 0."""
    return v if np.isfinite(v).all() else np.nan_to_num(v)


def start_at_fix(t_us: int, fix: FixMeasurement) -> MotionEstimate:
    """The filter at a fix."""
    x, p = np.zeros(X_SIZE), np.zeros((ERROR_SIZE, ERROR_SIZE))
    x[R : R + 3], x[X_Q] = fix.r_ecef_m, 1.0
    p[0:3, 0:3] = fix.axes.T @ np.diag(fix.variance_m2) @ fix.axes
    finite = fix.v_ned_mps is not None and np.isfinite(fix.v_ned_mps).all()
    if fix.v_ned_mps is not None:
        x[3:6] = fix.axes.T @ np.nan_to_num(fix.v_ned_mps)
    speed = 2.0 * VELOCITY_SIGMA_MPS[1] if finite else 10.0
    p[range(3, 6), range(3, 6)] = speed**2
    set_unknown_attitude(p)
    # Without ranges the clock is not observed: any positive variance will do.
    p[CLOCK, CLOCK] = p[DRIFT, DRIFT] = 1.0
    return MotionEstimate(t_us, x, p)
