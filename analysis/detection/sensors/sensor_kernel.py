"""The tests of the other sensors over a block, compiled: see `sensor_tests`, `sensor_models`."""

import math
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
from analysis.samples.block import FIX, FIX_TYPE, IMU, NEVER_US, Indices, Stamps
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.numerics.linear import invert_positive_definite, multiply_matrices
from mavproxy_fault.numerics.rotations.rotation_kernel import rotation_matrix

FAILS_TO_ISOLATE = 3  # failures in a row, chosen: one outlier isolates no sensor
SIZE_SIGMAS = 4.0  # error of the field's size above which the magnetometer is at fault: p 6e-5
STALE_US = 500_000  # older samples are not tested
SLOW_US, FAILS, ISOLATED, HEALTHY_US = range(4)  # counters of a sensor
SAME_US = 10_000  # a fix this close to an epoch belongs to it: receivers send it after the ranges
ROW, T_US, REFERENCE, BY_FIX = range(4)  # of a decision
UNTESTED, SOUND, FAULTY = range(3)  # of the reference
# Columns of an outcome and their number; the last is a fix's type.
OF_ROW, SENSOR, CODE, STATISTIC, DOF, IS_OUT, DECIDED_US, FIX_OF, OUTCOME = range(9)
NOISE_MEMORY_S = 30.0  # memory of a sensor's noise
SIGMA, WALK, LEAST_SIGMA = range(3)  # rows of the noise
# Sensor by kind of sample (of a fix the first of two); -1: none
SENSOR_OF = (-1, 0, 1, 2, 3, 4, -1, -1, models.GPS_POSITION, -1, -1, -1, -1, -1)

Counts = NDArray[np.int64]


class SensorStates(NamedTuple):
    """The state of s sensors; `run_sensor_tests` changes it in place.

    `stamps` (s,) and `values` (s, WIDTH): the newest sample since the newest decision, NEVER_US if
    there is none; `counts` (s, 4) and `slow` (s, 12): counters, and the slow states, b (3,) and p
    (3, 3); `shown` (s,): the variance of the innovations; `last` (4,): the newest decision;
    `turning` (1,): the largest rate of turn since, rad/s.
    """

    stamps: Stamps
    values: Vector
    counts: Counts
    slow: Vector
    shown: Vector
    last: Counts
    turning: Vector

    def copy(self) -> "SensorStates":
        """A copy, to be changed."""
        return SensorStates(
            self.stamps.copy(),
            self.values.copy(),
            self.counts.copy(),
            self.slow.copy(),
            self.shown.copy(),
            self.last.copy(),
            self.turning.copy(),
        )


class BlockRows(NamedTuple):
    """A block as the kernel reads it: kind (n,), t_us (n,), values (n, WIDTH)."""

    kind: Indices
    t_us: Stamps
    values: Vector


class EpochDecisions(NamedTuple):
    """The detector's decisions on a block, and its filter before the first and at each.

    `numbers` (m, 4): row, stamp, state of the reference (UNTESTED, SOUND, FAULTY) and whether a fix
    was its input; x (1 + m, 21), p (1 + m, 20, 20), inertial (1 + m,): whether the IMU moves it.
    """

    numbers: Counts
    x: Vector
    p: Vector
    inertial: Indices


class SensorLimits(NamedTuple):
    """`noise` (3, s): one sigma, the slow states' walk and one sigma of the best sensor, as
    `SensorNoise` has them; `thresholds` (4,) by degrees of freedom; `readmit_us`."""

    noise: Vector
    thresholds: Vector
    readmit_us: float


@compiled
def filter_view(x: Vector, p: Vector, inertial: bool) -> Vector:
    """The filter, state x (19,) and covariance p (18, 18), as sensor models see it (VIEW,)."""
    at = np.zeros(models.VIEW)
    lat, lon, height = geodetic_position(x[0:3])
    axes = ned_axes(lat, lon)
    rot = multiply_matrices(axes, rotation_matrix(x[6:10]))
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
def _innovation(
    sensor: int, z: Vector, at: Vector, b: Vector, known: bool, sigma: float, out: Vector
) -> tuple[int, int]:
    """The innovation by the sensor's own model."""
    if sensor == models.MAG:
        return models.mag_innovation(z, at, b, known, sigma, out)
    if sensor == models.BARO:
        return models.baro_innovation(z, at, b, known, sigma, out)
    if sensor == models.AIRSPEED:
        return models.airspeed_innovation(z, at, b, known, sigma, out)
    if sensor == models.RANGE:
        return models.range_innovation(z, at, b, known, sigma, out)
    if sensor == models.VISION:
        return models.vision_innovation(z, at, b, known, sigma, out)
    if sensor == models.GPS_POSITION:
        return models.gps_position_innovation(z, at, b, known, sigma, out)
    return models.gps_velocity_innovation(z, at, b, known, sigma, out)


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
    inv = invert_positive_definite(s)
    gain = multiply_matrices(ph, inv)
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
def _with_hysteresis(count: Counts, failed: bool, own: bool, t_us: int, readmit_us: float) -> None:
    """Isolate after some failures of the sensor's own in a row, readmit after health; in place."""
    since_us = count[HEALTHY_US]
    count[HEALTHY_US] = NEVER_US
    if failed:
        count[FAILS] += 1
        if own and count[FAILS] >= FAILS_TO_ISOLATE:
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
def _sigma(sensor: int, states: SensorStates, noise: Vector) -> float:
    """One sigma of a sensor: the assumed one, or its observed one if that is less."""
    shown = math.sqrt(states.shown[sensor])
    sigma: float = min(noise[SIGMA, sensor], max(noise[LEAST_SIGMA, sensor], shown))
    return sigma


@compiled
def _is_own_fault(sensor: int, z: Vector, b: Vector, sigma: float) -> bool:
    """Whether the failure is the sensor's own: a field of the right size in the wrong direction may
    be due to the attitude, which is the IMU's fault."""
    if sensor != models.MAG:
        return True
    size, expected = 0.0, 0.0
    for i in range(3):
        size += z[i] ** 2
        expected += b[i] ** 2
    # Written so that NaN is the sensor's own fault.
    return not abs(math.sqrt(size) - math.sqrt(expected)) <= SIZE_SIGMAS * sigma


@compiled
def _test(
    sensor: int, at: Vector, states: SensorStates, limits: SensorLimits
) -> tuple[int, float, int]:
    """One sensor's test: code, statistic and degrees of freedom."""
    out = np.zeros((7, 3))
    noise = limits.noise
    count, slow_states, k, t_us = (
        states.counts[sensor],
        states.slow[sensor],
        SLOW_STATES[sensor],
        states.last[T_US],
    )
    known = count[SLOW_US] != NEVER_US
    at[LATE_S] = (t_us - states.stamps[sensor]) * 1e-6
    z, sigma = states.values[sensor], _sigma(sensor, states, noise)
    code, m = _innovation(sensor, z, at, slow_states[:3], known, sigma, out)
    if code == STARTED:
        for i in range(k):
            slow_states[i] = out[V, i]
            for j in range(k):
                slow_states[3 + 3 * i + j] = out[S + i, j]
        count[SLOW_US] = t_us
        return NOTHING, 0.0, 0
    if code != TESTED:
        return code, 0.0, 0
    moved = slow_states.copy()
    dt_s = max((t_us - count[SLOW_US]) * 1e-6, 0.0)
    for i in range(k):
        # The diagonal of p (3, 3), which follows the three states.
        moved[3 + 4 * i] += noise[WALK, sensor] * dt_s
    q, after = _updated(out, moved, m, k)
    failed = not q <= limits.thresholds[m]
    own = _is_own_fault(sensor, z, slow_states[:3], sigma)
    _with_hysteresis(count, failed, own, t_us, limits.readmit_us)
    if not failed and not count[ISOLATED]:  # else the slow states are frozen
        for i in range(12):
            slow_states[i] = after[i]
        share = min(dt_s / NOISE_MEMORY_S, 1.0)
        for i in range(m):
            states.shown[sensor] += share / m * (out[V, i] ** 2 - states.shown[sensor])
    count[SLOW_US] = t_us
    return code, q, m


@compiled
def _store_sample(sensor: int, t_us: int, numbers: Vector, states: SensorStates) -> None:
    """Store a sample as the sensor's newest."""
    states.stamps[sensor] = t_us
    for i in range(len(numbers)):
        states.values[sensor, i] = numbers[i]


@compiled
def _calls_for_tests(
    row: int, kind: int, t_us: int, decisions: Counts, used: int, last: Counts
) -> tuple[bool, int]:
    """Whether a row calls for tests by the decision `last`; how many decisions are used then."""
    if used < len(decisions) and decisions[used, ROW] == row:
        if decisions[used, REFERENCE] == UNTESTED:
            return False, used + 1
        for i in range(4):
            last[i] = decisions[used, i]
        return True, used + 1
    fits = kind == FIX and last[REFERENCE] != UNTESTED and abs(t_us - last[T_US]) <= SAME_US
    return fits, used


@compiled
def _outcomes(
    row: int,
    first: int,
    at: Vector,
    states: SensorStates,
    limits: SensorLimits,
    found: Vector,
    count: int,
) -> int:
    """The tests from the `first` sensor on, appended to `found` at `count`; the new count."""
    sound = states.last[REFERENCE] == SOUND
    for sensor in range(first, len(states.stamps)):
        late_us = abs(states.stamps[sensor] - states.last[T_US])
        if states.stamps[sensor] == NEVER_US or (sound and late_us > STALE_US):
            continue
        code, q, m = NO_REFERENCE, 0.0, 0
        if sound:
            code, q, m = _test(sensor, at, states, limits)
        if code != NOTHING:
            found[count, OF_ROW], found[count, SENSOR], found[count, CODE] = row, sensor, code
            found[count, STATISTIC], found[count, DOF] = q, m
            found[count, IS_OUT] = states.counts[sensor, ISOLATED]
            # A fix comes later than its stamp; a result is not older than its sample.
            found[count, DECIDED_US] = max(states.last[T_US], states.stamps[sensor])
            found[count, FIX_OF] = states.values[sensor, FIX_TYPE]
            count += 1
    for sensor in range(first, len(states.stamps)):
        # Each sample is tested once.
        states.stamps[sensor] = NEVER_US
    return count


@compiled
def _update_turn_rate(rates: Vector, states: SensorStates) -> None:
    """Update the largest rate of turn."""
    rate = math.sqrt(rates[0] ** 2 + rates[1] ** 2 + rates[2] ** 2)
    if rate > states.turning[0]:  # false for NaN
        states.turning[0] = rate


@compiled
def run_sensor_tests(
    rows: BlockRows, decisions: EpochDecisions, states: SensorStates, limits: SensorLimits
) -> Vector:
    """Every sensor's test at each decision on an epoch; a receiver's at fixes that belong to one.

    `states` is changed in place. The outcomes (k, OUTCOME) are: row, sensor, code, statistic,
    degrees of freedom, whether it is isolated, the decision's stamp, and the type of a fix.
    """
    # A bound on the outcomes, so that no array grows in the loop.
    bound = len(decisions.numbers)
    for row in range(len(rows.kind)):
        bound += rows.kind[row] == FIX
    found = np.empty((len(states.stamps) * bound, OUTCOME))
    count = used = 0
    for row in range(len(rows.kind)):
        kind, t_us = rows.kind[row], rows.t_us[row]
        sensor = SENSOR_OF[kind]
        if sensor >= 0:
            _store_sample(sensor, t_us, rows.values[row], states)
        elif kind == IMU:
            _update_turn_rate(rows.values[row], states)
        if kind == FIX:
            _store_sample(sensor + 1, t_us, rows.values[row], states)
        before = used
        fits, used = _calls_for_tests(row, kind, t_us, decisions.numbers, used, states.last)
        if not fits:
            continue
        # A late fix comes when other sensors' newest samples belong to the next epoch.
        first = 0 if used > before else models.GPS_POSITION
        if states.last[BY_FIX]:  # the fix is the filter's input
            states.stamps[models.GPS_POSITION] = states.stamps[models.GPS_VELOCITY] = NEVER_US
        if states.stamps.max() == NEVER_US:
            continue
        at = np.zeros(models.VIEW)
        if states.last[REFERENCE] == SOUND:
            at = filter_view(decisions.x[used], decisions.p[used], decisions.inertial[used] != 0)
            at[models.TURNING] = states.turning[0]
        count = _outcomes(row, first, at, states, limits, found, count)
        if first == 0:
            states.turning[0] = 0.0
    return found[:count]
