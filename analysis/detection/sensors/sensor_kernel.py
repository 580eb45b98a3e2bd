"""The tests of the other sensors over a block, compiled: see `reference` and `reference_models`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.detection.sensors import sensor_models as models
from analysis.detection.sensors.sensor_models import (
    LATE_S,
    NO_REFERENCE,
    NOTHING,
    SLOW_STATES,
    STARTED,
    TESTED,
    H,
    S,
    V,
)
from analysis.orbits.broadcast import geodetic, ned_axes
from analysis.samples.block import FIX, Indices, Stamps
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.linear import inverse, multiply
from mavproxy_fault.numerics.rotation_kernel import matrix

FAILS_TO_ISOLATE = 3
STALE_US = 500_000
SLOW_US, FAILS, ISOLATED, HEALTHY_US = range(4)  # of what is counted for each sensor
NEVER_US = -(1 << 62)
SAME_US = 10_000  # a fix belongs to the epoch of this instant: a receiver sends it after the ranges
ROW, T_US, HOW, BY_FIX = range(4)  # of a decision
UNTESTED, SOUND, UNSOUND = range(3)  # how
SAID = 8  # numbers that are said of a sensor, see `judge`
# By kind of sample the sensor it belongs to (of a fix the first of two); -1: none
SENSOR_OF = (-1, 0, 1, 2, 3, 4, -1, -1, models.GPS_POSITION, -1, -1, -1)

Counts = NDArray[np.int64]


class Kept(NamedTuple):
    """What is kept of s sensors; `judge` changes it in place.

    `stamps` (s,) and `values` (s, WIDTH): the newest sample since the newest decision, NEVER_US
    where there is none; `counts` (s, 4) and `slow` (s, 12): what is counted, and the slow states, b
    (3,) and p (3, 3); `last` (4,): the newest decision.
    """

    stamps: Stamps
    values: Vector
    counts: Counts
    slow: Vector
    last: Counts

    def copy(self) -> "Kept":
        """The same, to be changed."""
        return Kept(
            self.stamps.copy(),
            self.values.copy(),
            self.counts.copy(),
            self.slow.copy(),
            self.last.copy(),
        )


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
def _test(
    sensor: int, at: Vector, kept: Kept, noise: Vector, thresholds: Vector, readmit_us: float
) -> tuple[int, float, int]:
    """One sensor's test: code, statistic and degrees of freedom."""
    out = np.zeros((7, 3))
    count, states, k, t_us = (
        kept.counts[sensor],
        kept.slow[sensor],
        SLOW_STATES[sensor],
        kept.last[T_US],
    )
    known = count[SLOW_US] != NEVER_US
    at[LATE_S] = (t_us - kept.stamps[sensor]) * 1e-6
    code, m = _seen(sensor, kept.values[sensor], at, states[:3], known, noise[0, sensor], out)
    if code == STARTED:
        for i in range(k):
            states[i] = out[V, i]
            for j in range(k):
                states[3 + 3 * i + j] = out[S + i, j]
        count[SLOW_US] = t_us
        return NOTHING, 0.0, 0
    if code != TESTED:
        return code, 0.0, 0
    moved = states.copy()
    dt_s = max((t_us - count[SLOW_US]) * 1e-6, 0.0)
    for i in range(k):
        moved[3 + 4 * i] += noise[1, sensor] * dt_s
    q, after = _updated(out, moved, m, k)
    failed = not q <= thresholds[m]
    _with_hysteresis(count, failed, t_us, readmit_us)
    if not failed and not count[ISOLATED]:  # or else the slow states keep still
        for i in range(12):
            states[i] = after[i]
    count[SLOW_US] = t_us
    return code, q, m


@compiled
def _keep(sensor: int, t_us: int, numbers: Vector, kept: Kept) -> None:
    """Take a sample as the sensor's newest."""
    kept.stamps[sensor] = t_us
    for i in range(len(numbers)):
        kept.values[sensor, i] = numbers[i]


@compiled
def _decided(
    row: int, kind: int, t_us: int, decisions: Counts, used: int, last: Counts
) -> tuple[bool, int]:
    """Whether a row calls for tests, of which `last` is the decision; how many are used then."""
    if used < len(decisions) and decisions[used, ROW] == row:
        if decisions[used, HOW] == UNTESTED:
            return False, used + 1
        for i in range(4):
            last[i] = decisions[used, i]
        return True, used + 1
    fits = kind == FIX and last[HOW] != UNTESTED and abs(t_us - last[T_US]) <= SAME_US
    return fits, used


@compiled
def judge(
    kind: Indices,
    t_us: Stamps,
    values: Vector,
    decisions: Counts,
    x: Vector,
    p: Vector,
    inertial: Indices,
    kept: Kept,
    noise: Vector,
    thresholds: Vector,
    readmit_us: float,
) -> Vector:
    """Every sensor's test at each decision on an epoch, and at fixes that belong to one.

    Parameters
    ----------
    kind, t_us, values : (n,), (n,), (n, WIDTH)
        A block.
    decisions : (m, 4)
        Row, stamp, how the filter is (UNTESTED, SOUND, UNSOUND) and whether a fix was its input.
    x, p, inertial : (1 + m, 21), (1 + m, 20, 20), (1 + m,)
        The filter before the first decision and at each, and whether the IMU moves it.
    kept
        Changed in place.
    noise : (2, s)
        One sigma and the slow states' walk, as `SensorNoise` gives them.
    thresholds : (4,)
        By degrees of freedom.

    Returns
    -------
    What is said (k, 8): row, sensor, code, statistic, degrees of freedom, whether it is isolated,
    the decision's stamp, and the sample's seventh number, a fix's type.
    """
    sensors, most = len(kept.stamps), len(decisions)
    for row in range(len(kind)):
        most += kind[row] == FIX
    said = np.empty((sensors * most, SAID))
    count = used = 0
    for row in range(len(kind)):
        sensor = SENSOR_OF[kind[row]]
        if sensor >= 0:
            _keep(sensor, t_us[row], values[row], kept)
        if kind[row] == FIX:
            _keep(sensor + 1, t_us[row], values[row], kept)
        fits, used = _decided(row, kind[row], t_us[row], decisions, used, kept.last)
        if not fits:
            continue
        if kept.last[BY_FIX]:  # it is the filter's own input
            kept.stamps[models.GPS_POSITION] = kept.stamps[models.GPS_VELOCITY] = NEVER_US
        if kept.stamps.max() == NEVER_US:
            continue
        sound = kept.last[HOW] == SOUND
        at = view(x[used], p[used], inertial[used] != 0) if sound else np.zeros(models.VIEW)
        for sensor in range(sensors):
            late_us = abs(kept.stamps[sensor] - kept.last[T_US])
            if kept.stamps[sensor] == NEVER_US or (sound and late_us > STALE_US):
                continue
            code, q, m = NO_REFERENCE, 0.0, 0
            if sound:
                code, q, m = _test(sensor, at, kept, noise, thresholds, readmit_us)
            if code != NOTHING:
                said[count, 0], said[count, 1], said[count, 2] = row, sensor, code
                said[count, 3], said[count, 4] = q, m
                said[count, 5] = kept.counts[sensor, ISOLATED]
                said[count, 6], said[count, 7] = kept.last[T_US], kept.values[sensor, 6]
                count += 1
        for sensor in range(sensors):
            kept.stamps[sensor] = NEVER_US
    return said[:count]
