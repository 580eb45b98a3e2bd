"""The tests of the other sensors at one epoch, compiled: see `reference` and `reference_models`."""

import numpy as np
from numpy.typing import NDArray

from analysis import reference_models as models
from analysis.block import Stamps
from analysis.estimators.rotations import matrix
from analysis.fdi.linear import inverse, multiply
from analysis.gnss import geodetic, ned_axes
from analysis.reference_models import LATE_S, NOTHING, SLOW_STATES, STARTED, TESTED, H, S, V
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled

FAILS_TO_ISOLATE = 3
STALE_US = 500_000
SLOW_US, FAILS, ISOLATED, HEALTHY_US = range(4)  # of what is counted for each sensor
NEVER_US = -(1 << 62)
CODE, STATISTIC, DOF = range(3)  # of what is said of each sensor

Counts = NDArray[np.int64]


@compiled
def view(x: Vector, p: Vector, inertial: bool) -> Vector:
    """The filter, state x (19,) and covariance p (18, 18), as the sensors see it (VIEW,)."""
    at = np.zeros(models.VIEW)
    lat, lon, height = geodetic(x[0:3])
    axes = ned_axes(lat, lon)
    rot = multiply(axes, matrix(x[6:10]))
    at[models.HEIGHT], at[models.UPRIGHT] = height, 1.0 if inertial else 0.0
    begins = (models.P_POSITION, models.P_VELOCITY, models.P_ATTITUDE)
    for i in range(3):
        at[models.R + i] = x[i]
        for j in range(3):
            at[models.V_NED + i] += axes[i, j] * x[3 + j]
            at[models.AXES + 3 * i + j] = axes[i, j]
            at[models.ROT + 3 * i + j] = rot[i, j]
            for part in range(3):
                for k in range(9):
                    turned = axes[i, k // 3] * axes[j, k % 3]
                    cell = turned * p[3 * part + k // 3, 3 * part + k % 3]
                    at[begins[part] + 3 * i + j] += cell
    return at


@compiled
def _seen(
    sensor: int, z: Vector, at: Vector, b: Vector, known: bool, sigma: float, out: Vector
) -> tuple[int, int]:
    """What the sensor's own function says."""
    if sensor == models.MAG:
        return models.mag(z, at, b, known, sigma, out)
    if sensor == models.BARO:
        return models.baro(z, at, b, known, sigma, out)
    if sensor == models.AIRSPEED:
        return models.airspeed(z, at, b, known, sigma, out)
    if sensor == models.RANGE:
        return models.rangefinder(z, at, b, known, sigma, out)
    if sensor == models.VISION:
        return models.vision(z, at, b, known, sigma, out)
    if sensor == models.GPS_POSITION:
        return models.gps_position(z, at, b, known, sigma, out)
    return models.gps_velocity(z, at, b, known, sigma, out)


@compiled
def _updated(out: Vector, slow: Vector, m: int, k: int) -> tuple[float, Vector]:
    """v' inv(h p h' + r) v of `out` (7, 3), and the k slow states (12,), b and p, after it."""
    ph, s = np.zeros((k, m)), np.empty((m, m))
    for j in range(m):
        for i in range(k):
            for n in range(k):
                ph[i, j] += slow[3 + 3 * i + n] * out[H + j, n]
    for i in range(m):
        for j in range(m):
            s[i, j] = out[S + i, j]
            for n in range(k):
                s[i, j] += out[H + i, n] * ph[n, j]
    inv = inverse(s)
    gain = multiply(ph, inv)
    q = 0.0
    after = slow.copy()
    for j in range(m):
        for i in range(m):
            q += out[V, i] * inv[i, j] * out[V, j]
        for i in range(k):
            after[i] += gain[i, j] * out[V, j]
            for n in range(k):
                after[3 + 3 * i + n] -= gain[i, j] * ph[n, j]
    return q, after


@compiled
def _with_hysteresis(count: Counts, failed: bool, t_us: int, readmit_us: float) -> None:
    """Isolated after some failures running, and no more after a while of health; in place."""
    since_us = count[HEALTHY_US]
    count[HEALTHY_US] = NEVER_US
    if failed:
        count[FAILS] += 1
        if count[FAILS] >= FAILS_TO_ISOLATE:
            count[ISOLATED] = 1
        return
    count[FAILS] = 0
    if count[ISOLATED]:
        if since_us == NEVER_US:
            since_us = t_us
        if t_us - since_us >= readmit_us:
            count[ISOLATED] = 0
        else:
            count[HEALTHY_US] = since_us


@compiled
def judge(
    x: Vector,
    p: Vector,
    inertial: bool,
    t_us: int,
    stamps: Stamps,
    values: Vector,
    counts: Counts,
    slow: Vector,
    sigmas: Vector,
    walks: Vector,
    thresholds: Vector,
    readmit_us: float,
) -> tuple[Vector, Counts, Vector]:
    """Every sensor's test at an epoch.

    Parameters
    ----------
    x, p, inertial : (19,), (18, 18)
        The filter, and whether the IMU moves it.
    stamps, values : (s,), (s, WIDTH)
        The newest sample of each sensor; NEVER_US where there is none.
    counts, slow : (s, 4), (s, 12)
        What is counted of each sensor, and its slow states: b (3,) and p (3, 3).
    sigmas, walks : (s,), (s,)
        As `SensorNoise` gives them.
    thresholds : (4,)
        By degrees of freedom.

    Returns
    -------
    What is said of each sensor (s, 3), and `counts` and `slow` after it.
    """
    said = np.zeros((len(stamps), 3))
    counts, slow = counts.copy(), slow.copy()
    at = view(x, p, inertial)
    for sensor in range(len(stamps)):
        if stamps[sensor] == NEVER_US or abs(stamps[sensor] - t_us) > STALE_US:
            continue
        out = np.zeros((7, 3))
        count, states, k = counts[sensor], slow[sensor], SLOW_STATES[sensor]
        known = count[SLOW_US] != NEVER_US
        at[LATE_S] = (t_us - stamps[sensor]) * 1e-6
        code, m = _seen(sensor, values[sensor], at, states[:3], known, sigmas[sensor], out)
        said[sensor, CODE] = code
        if code == STARTED:
            said[sensor, CODE] = NOTHING
            for i in range(k):
                states[i] = out[V, i]
                for j in range(k):
                    states[3 + 3 * i + j] = out[S + i, j]
            count[SLOW_US] = t_us
        elif code == TESTED:
            moved = states.copy()
            dt_s = max((t_us - count[SLOW_US]) * 1e-6, 0.0)
            for i in range(k):
                moved[3 + 4 * i] += walks[sensor] * dt_s
            q, after = _updated(out, moved, m, k)
            failed = not q <= thresholds[m]
            _with_hysteresis(count, failed, t_us, readmit_us)
            if not failed and not count[ISOLATED]:  # or else the slow states keep still
                for i in range(12):
                    states[i] = after[i]
            count[SLOW_US] = t_us
            said[sensor, STATISTIC], said[sensor, DOF] = q, m
    return said, counts, slow
