"""The tests of the other sensors at one epoch, compiled: see `reference` and `reference_models`."""

import numpy as np
from numpy.typing import NDArray

from analysis import reference_models as models
from analysis.block import Stamps
from analysis.fdi.inertial import matrix
from analysis.fdi.linear import apply, inverse, multiply, transposed
from analysis.gnss import geodetic, ned_axes
from analysis.reference_models import NOTHING, SLOW_STATES, STARTED, TESTED, SensorNoise, View
from analysis.samples import Vector
from mavproxy_fault.wire.compiled import compiled

FAILS_TO_ISOLATE = 3
STALE_US = 500_000
SLOW_US, FAILS, ISOLATED, HEALTHY_US = range(4)  # of what is counted for each sensor
NEVER_US = -(1 << 62)
CODE, STATISTIC, DOF = range(3)  # of what is said of each sensor

Counts = NDArray[np.int64]


@compiled
def _in_axes(axes: Vector, p: Vector, at: int) -> Vector:
    """The covariance (3, 3) of three errors from `at` on, turned into the axes."""
    part = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            part[i, j] = p[at + i, at + j]
    return multiply(multiply(axes, part), transposed(axes))


@compiled
def view(x: Vector, p: Vector, inertial: bool) -> View:
    """The filter, state x (19,) and covariance p (18, 18), as the sensors see it."""
    lat, lon, height = geodetic(x[0:3])
    axes = ned_axes(lat, lon)
    return View(
        x[0:3],
        height,
        axes,
        apply(axes, x[3:6]),
        multiply(axes, matrix(x[6:10])),
        inertial,
        _in_axes(axes, p, 0),
        _in_axes(axes, p, 3),
        _in_axes(axes, p, 6),
        0.0,
    )


@compiled
def _seen(
    sensor: int,
    z: Vector,
    at: View,
    b: Vector,
    known: bool,
    noise: SensorNoise,
    v: Vector,
    h: Vector,
    r: Vector,
) -> tuple[int, int]:
    """What the sensor's own function says, and the variance per second of its slow states."""
    if sensor == models.MAG:
        return models.mag(z, at, b, known, noise, v, h, r)
    if sensor == models.BARO:
        return models.baro(z, at, b, known, noise, v, h, r)
    if sensor == models.AIRSPEED:
        return models.airspeed(z, at, b, known, noise, v, h, r)
    if sensor == models.RANGE:
        return models.rangefinder(z, at, b, known, noise, v, h, r)
    if sensor == models.VISION:
        return models.vision(z, at, b, known, noise, v, h, r)
    if sensor == models.GPS_POSITION:
        return models.gps_position(z, at, b, known, noise, v, h, r)
    return models.gps_velocity(z, at, b, known, noise, v, h, r)


@compiled
def _walk(sensor: int, noise: SensorNoise) -> float:
    """How fast the slow states walk, per square root of a second."""
    if sensor == models.MAG:
        return noise.field_walk_gauss
    if sensor == models.BARO:
        return noise.baro_walk_m
    if sensor == models.AIRSPEED:
        return noise.wind_walk_mps
    if sensor == models.RANGE:
        return noise.terrain_walk_m
    if sensor == models.VISION:
        return noise.vision_walk_m
    return noise.gps_walk_m


@compiled
def _updated(v: Vector, h: Vector, r: Vector, slow: Vector, m: int, k: int) -> tuple[float, Vector]:
    """v' inv(h p h' + r) v, and the k slow states (12,), b and p by rows, after it."""
    ph, s = np.zeros((k, m)), np.empty((m, m))
    for i in range(k):
        for j in range(m):
            for n in range(k):
                ph[i, j] += slow[3 + 3 * i + n] * h[j, n]
    for i in range(m):
        for j in range(m):
            s[i, j] = r[i, j]
            for n in range(k):
                s[i, j] += h[i, n] * ph[n, j]
    inv = inverse(s)
    u = apply(inv, v[:m])
    gain = multiply(ph, inv)
    q = 0.0
    for i in range(m):
        q += v[i] * u[i]
    after = slow.copy()
    for i in range(k):
        for j in range(m):
            after[i] += gain[i, j] * v[j]
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
    noise: SensorNoise,
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
        v, h, r = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
        count, states, k = counts[sensor], slow[sensor], SLOW_STATES[sensor]
        known = count[SLOW_US] != NEVER_US
        late_s = (t_us - stamps[sensor]) * 1e-6
        now = View(
            at.r_ecef_m, at.height_m, at.axes, at.v_ned_mps, at.rot_nb, at.upright,
            at.p_position, at.p_velocity, at.p_attitude, late_s,
        )  # fmt: skip
        code, m = _seen(sensor, values[sensor], now, states[:3], known, noise, v, h, r)
        said[sensor, CODE] = code
        if code == STARTED:
            said[sensor, CODE] = NOTHING
            for i in range(k):
                states[i] = v[i]
                for j in range(k):
                    states[3 + 3 * i + j] = r[i, j]
            count[SLOW_US] = t_us
        elif code == TESTED:
            moved = states.copy()
            dt_s = max((t_us - count[SLOW_US]) * 1e-6, 0.0)
            for i in range(k):
                moved[3 + 4 * i] += _walk(sensor, noise) ** 2 * dt_s
            q, after = _updated(v, h, r, moved, m, k)
            failed = not q <= thresholds[m]
            _with_hysteresis(count, failed, t_us, readmit_us)
            if not failed and not count[ISOLATED]:  # or else the slow states keep still
                for i in range(12):
                    states[i] = after[i]
            count[SLOW_US] = t_us
            said[sensor, STATISTIC], said[sensor, DOF] = q, m
    return said, counts, slow
