"""A receiver's own position and velocity against the filter, for when there are no raw ranges."""

import math
from typing import NamedTuple

import numpy as np

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import (
    ACCEL_BIAS_SIGMA_MPS2,
    BA,
    BG,
    CLOCK,
    DRIFT,
    ERROR_SIZE,
    GYRO_BIAS_SIGMA_RPS,
    PSI,
    X_Q,
    X_SIZE,
    R,
)
from analysis.detection.filter.information import innovation_statistic, measurement_update
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.detection.statistics.false_alarm_rates import FalseAlarmRates
from analysis.samples.sample import GpsFix, Vector
from mavproxy_fault.numerics.earth import ecef_of
from mavproxy_fault.numerics.earth_kernel import ned_axes

FIX_3D = 3
POSITION_SIGMA_M = (1.0, 1.5)  # horizontal, vertical; where the receiver claims less
UNKNOWN_SIGMA_M = 3.0
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
    def passes(self) -> bool:
        """Whether the fix fits the prediction."""
        return self.statistic <= self.threshold


def fix_measurement(fix: GpsFix) -> tuple[FixMeasurement | None, str]:
    """The fix in ECEF, or why it cannot be used."""
    if fix.fix_type < FIX_3D:
        return None, f"fix type {fix.fix_type}; 3 or more is a position"
    if not all(map(math.isfinite, (fix.lat_deg, fix.lon_deg, fix.alt_m))):
        return None, "the position is not finite"
    # Receivers that have no position send zeros.
    if fix.lat_deg == 0.0 and fix.lon_deg == 0.0:
        return None, "the position is 0, 0"
    lat, lon = np.radians(fix.lat_deg), np.radians(fix.lon_deg)
    # Claims are believed upwards only: many receivers are too sure of themselves.
    sigma = [
        max(claimed, floor) if math.isfinite(claimed) and claimed > 0.0 else UNKNOWN_SIGMA_M
        for claimed, floor in zip((fix.eph_m, fix.epv_m), POSITION_SIGMA_M, strict=True)
    ]
    variance = np.array([sigma[0], sigma[0], sigma[1]]) ** 2
    r_ecef_m = np.array(ecef_of(lat, lon, np.asarray(fix.alt_m)))
    axes = ned_axes(float(lat), float(lon))
    return FixMeasurement(r_ecef_m, axes, variance, fix.v_ned_mps, VELOCITY_VARIANCE), ""


def run_fix_tests(
    measured: FixMeasurement, motion: MotionEstimate, config: FalseAlarmRates
) -> tuple[FixTest, FixTest | None]:
    """Test position, and velocity where it is known, against the prediction."""
    h = np.zeros((3, ERROR_SIZE))
    h[:, 0:3] = measured.axes
    v = measured.axes @ (measured.r_ecef_m - motion.x[0:3])
    position = _fix_test(motion.p, v, h, measured.variance_m2, config.p_false_alarm)
    if measured.v_ned_mps is None:
        return position, None
    known = np.isfinite(measured.v_ned_mps)
    if not known.any():
        return position, None
    h = np.zeros((3, ERROR_SIZE))
    h[:, 3:6] = measured.axes
    v = measured.v_ned_mps - measured.axes @ motion.x[3:6]
    variance = measured.v_variance
    # To pick all of them takes as long as the test.
    if not known.all():
        v, h, variance = v[known], h[known], variance[known]
    return position, _fix_test(motion.p, v, h, variance, config.p_other)


def _fix_test(p: Vector, v: Vector, h: Vector, variance: Vector, p_false_alarm: float) -> FixTest:
    q = innovation_statistic(p, np.ascontiguousarray(h), variance, v)
    return FixTest(q, chi_square_threshold(len(v), p_false_alarm), v, h, variance)


def update_with_fix(motion: MotionEstimate, part: FixTest) -> MotionEstimate:
    """The filter after a test's measurement."""
    h = np.ascontiguousarray(part.h)
    x, p = measurement_update(motion.x, motion.p, h, part.variance, part.v)
    return motion._replace(x=x, p=p)


def known_or_zero(v: Vector) -> Vector:
    """A velocity (3,) without what is not known of it, which is rare."""
    return v if np.isfinite(v).all() else np.nan_to_num(v)


def start_at_fix(t_us: int, measured: FixMeasurement) -> MotionEstimate:
    """The filter at a fix."""
    x, p = np.zeros(X_SIZE), np.zeros((ERROR_SIZE, ERROR_SIZE))
    x[R : R + 3], x[X_Q] = measured.r_ecef_m, 1.0
    p[0:3, 0:3] = measured.axes.T @ np.diag(measured.variance_m2) @ measured.axes
    known = measured.v_ned_mps is not None and np.isfinite(measured.v_ned_mps).all()
    if measured.v_ned_mps is not None:
        x[3:6] = measured.axes.T @ np.nan_to_num(measured.v_ned_mps)
    speed = 2.0 * VELOCITY_SIGMA_MPS[1] if known else 10.0
    parts = ((3, speed), (PSI, 3.0), (BG, GYRO_BIAS_SIGMA_RPS), (BA, ACCEL_BIAS_SIGMA_MPS2))
    for at, sigma in parts:
        p[range(at, at + 3), range(at, at + 3)] = sigma**2
    # Without ranges nothing observes the clock: any variance above zero will do.
    p[CLOCK, CLOCK] = p[DRIFT, DRIFT] = 1.0
    return MotionEstimate(t_us, x, p)
