"""Which samples are held against which state: the kernel alone, with a compass that turns."""

import numpy as np
import pytest

from analysis.detection.sensors import sensor_kernel as kernel
from analysis.detection.sensors.sensor_models import GPS_POSITION, MAG, SENSORS, SensorNoise
from analysis.samples import block as kinds

FIELD_GAUSS = np.array([0.2, 0.0, 0.43])
STEP_US = 200_000
EPOCHS = 20


def turned(roll_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """The field in the body after a roll from level, and the quaternion."""
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    body = np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) @ FIELD_GAUSS
    return body, np.array([np.cos(roll_rad / 2), np.sin(roll_rad / 2), 0.0, 0.0])


def judged(rows: list[tuple[int, int, np.ndarray]], rolls: list[float]) -> list[tuple[int, float]]:
    """Sensor and statistic of each outcome: rows of kind, stamp and numbers, of which those of kind
    TRUTH are decisions with these rolls."""
    values = np.zeros((len(rows), kinds.WIDTH))
    for k, (_, _, numbers) in enumerate(rows):
        values[k, : len(numbers)] = numbers
    at = [k for k, (kind, _, _) in enumerate(rows) if kind == kinds.TRUTH]
    stamps = [rows[k][1] for k in at]
    numbers = np.array([[k, t, kernel.SOUND, 0] for k, t in zip(at, stamps, strict=True)])
    x, p = np.zeros((1 + len(at), 21)), np.zeros((1 + len(at), 20, 20))
    x[:, 0] = 6_378_137.0
    x[:, 6] = 1.0
    for k, roll in enumerate(rolls):
        x[1 + k, 6:10] = turned(roll)[1]
    count = len(SENSORS)
    noise = SensorNoise()
    counts = np.zeros((count, 4), np.int64)
    counts[:, [kernel.SLOW_US, kernel.HEALTHY_US]] = kernel.NEVER_US
    kept = kernel.SensorStates(
        np.full(count, kernel.NEVER_US), np.zeros((count, kinds.WIDTH)), counts,
        np.zeros((count, 12)), noise.quiet() ** 2, np.full(4, kernel.UNTESTED), np.zeros(1),
    )  # fmt: skip
    found = kernel.run_sensor_tests(
        kernel.BlockRows(
            np.array([kind for kind, _, _ in rows]), np.array([t for _, t, _ in rows]), values
        ),
        kernel.EpochDecisions(numbers, x, p, np.ones(1 + len(at), np.int64)),
        kept,
        kernel.SensorLimits(
            np.stack([noise.sigmas(), noise.walks(), noise.quiet()]), np.full(4, 26.0), 1e6
        ),
    )
    return [(int(row[kernel.SENSOR]), float(row[kernel.STATISTIC])) for row in found]


def level() -> tuple[list[tuple[int, int, np.ndarray]], list[float]]:
    """Some epochs of a level vehicle."""
    rows = []
    for k in range(EPOCHS):
        rows.append((kinds.MAG, k * STEP_US, FIELD_GAUSS))
        rows.append((kinds.TRUTH, k * STEP_US, np.zeros(0)))
    return rows, [0.0] * EPOCHS


def test_a_late_fix_does_not_test_other_samples_with_an_old_state() -> None:
    rows, rolls = level()
    epoch_us = (EPOCHS - 1) * STEP_US
    body, _ = turned(0.2)
    rows.append((kinds.MAG, epoch_us + 160_000, body))
    fix = np.zeros(kinds.WIDTH)
    rows.append((kinds.FIX, epoch_us, fix))
    late = judged(rows, rolls)[EPOCHS - 1 :]
    assert MAG not in [sensor for sensor, _ in late]
    assert GPS_POSITION in [sensor for sensor, _ in late]
    # The next epoch, by when the state has turned too, tests it.
    rows.append((kinds.TRUTH, epoch_us + STEP_US, np.zeros(0)))
    (*_, (sensor, statistic)) = judged(rows, [*rolls, 0.2])
    assert sensor == MAG
    assert statistic < 1.0


@pytest.mark.parametrize(("rate_rps", "alarm"), [(0.0, True), (3.0, False)])
def test_an_older_sample_may_have_another_attitude(rate_rps: float, alarm: bool) -> None:
    rows, rolls = level()
    epoch_us = EPOCHS * STEP_US
    rows.append((kinds.IMU, epoch_us - 60_000, np.array([rate_rps, 0.0, 0.0])))
    rows.append((kinds.MAG, epoch_us - 50_000, turned(0.15)[0]))
    rows.append((kinds.TRUTH, epoch_us, np.zeros(0)))
    (*_, (sensor, statistic)) = judged(rows, [*rolls, 0.0])
    assert sensor == MAG
    assert (statistic > 26.0) is alarm
