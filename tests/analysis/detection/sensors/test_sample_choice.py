"""Which samples are held against which state: without the detector, with a compass that turns."""

import msgspec
import numpy as np
import pytest

from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.filter.inertial import ERROR_SIZE, X_SIZE
from analysis.detection.sensors.sensor_models import MODELS
from analysis.detection.sensors.sensor_tests import NavigationDetector
from analysis.results import Decision
from analysis.samples import block as kinds

FIELD_GAUSS = np.array([0.2, 0.0, 0.43])
STEP_US = 200_000
EPOCHS = 20


def turned(roll_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """The field in the body after a roll from level, and the quaternion."""
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    body = np.array([[1, 0, 0], [0, c, s], [0, -s, c]]) @ FIELD_GAUSS
    return body, np.array([np.cos(roll_rad / 2), np.sin(roll_rad / 2), 0.0, 0.0])


def judged(rows: list[tuple[int, int, np.ndarray]], rolls: list[float]) -> list[tuple[str, float]]:
    """Sensor and statistic of each outcome: rows of kind, stamp and numbers, of which those of kind
    TRUTH are decisions with these rolls."""
    values = np.zeros((len(rows), kinds.WIDTH))
    for k, (_, _, numbers) in enumerate(rows):
        values[k, : len(numbers)] = numbers
    block = kinds.Block(
        np.array([kind for kind, _, _ in rows]), np.array([t for _, t, _ in rows]), values, {}
    )
    detector = NavigationDetector()
    decided = []
    for k, roll in zip(np.flatnonzero(block.kind == kinds.TRUTH).tolist(), rolls, strict=True):
        x = np.zeros(X_SIZE)
        x[0], x[6:10] = 6_378_137.0, turned(roll)[1]
        motion = MotionEstimate(rows[k][1], x, np.zeros((ERROR_SIZE, ERROR_SIZE)), inertial=True)
        decided.append((k, decision(rows[k][1]), motion))
    states = detector.new_state().states
    states.sensors["mag"].variance = MODELS["mag"].least_sigma ** 2
    found, _ = detector._judged(block, decided, states)
    return [(result.sensor, result.statistic or 0.0) for _, result in found]


def decision(t_us: int) -> Decision:
    """A decision that finds the filter healthy."""
    return Decision(
        t_us=t_us, mode="inertial", statistic=1.0, threshold=2.0, dof=1, p_value=1.0,
        alarm=False, hypothesis="none", position_sigma_m=1.0,
    )  # fmt: skip


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
    assert "mag" not in [sensor for sensor, _ in late]
    assert "gps-position" in [sensor for sensor, _ in late]
    # The next epoch, by when the state has turned too, tests it.
    rows.append((kinds.TRUTH, epoch_us + STEP_US, np.zeros(0)))
    (*_, (sensor, statistic)) = judged(rows, [*rolls, 0.2])
    assert sensor == "mag"
    assert statistic < 1.0


@pytest.mark.parametrize(("rate_rps", "alarm"), [(0.0, True), (3.0, False)])
def test_an_older_sample_may_have_another_attitude(rate_rps: float, alarm: bool) -> None:
    rows, rolls = level()
    epoch_us = EPOCHS * STEP_US
    rows.append((kinds.IMU, epoch_us - 60_000, np.array([rate_rps, 0.0, 0.0])))
    rows.append((kinds.MAG, epoch_us - 50_000, turned(0.15)[0]))
    rows.append((kinds.TRUTH, epoch_us, np.zeros(0)))
    (*_, (sensor, statistic)) = judged(rows, [*rolls, 0.0])
    assert sensor == "mag"
    assert (statistic > 26.0) is alarm


def test_a_fix_is_compared_with_its_own_epoch_even_if_no_other_sensor_had_a_sample() -> None:
    order = [kinds.MAG, kinds.TRUTH, kinds.TRUTH, kinds.FIX]
    stamps = np.array([0, 0, STEP_US, STEP_US])
    values = np.zeros((4, kinds.WIDTH))
    values[:, :3] = FIELD_GAUSS
    x = np.zeros(X_SIZE)
    x[0], x[6] = 6_378_137.0, 1.0
    motion = MotionEstimate(0, x, np.zeros((ERROR_SIZE, ERROR_SIZE)), inertial=True)
    faulty = msgspec.structs.replace(decision(STEP_US), hypothesis="imu")
    detector = NavigationDetector()
    found, _ = detector._judged(
        kinds.Block(np.array(order), stamps, values, {}),
        [(1, decision(0), motion), (2, faulty, motion)],
        detector.new_state().states,
    )
    assert [result.reason for row, result in found if row == 3] == ["no healthy reference"] * 2
