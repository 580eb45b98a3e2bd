"""Which samples are held against which state: without the detector, with a compass that turns."""

from collections.abc import Iterator

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


def pieces(block: kinds.Block) -> Iterator[kinds.BlockSlice]:
    """The rows up to each fix and each decision, which stands as a truth."""
    first = 0
    for last in np.flatnonzero(np.isin(block.kind, (kinds.TRUTH, kinds.FIX))).tolist():
        imu = first + np.flatnonzero(block.kind[first:last] == kinds.IMU)
        run = kinds.ImuRun(block.t_us[imu], block.values[imu, : kinds.IMU_ID])
        stamp = int(block.t_us[last])
        yield kinds.BlockSlice(
            block, first, last, run, np.zeros(len(imu)), 0, -1, int(block.kind[last]), stamp
        )
        first = last + 1


def judged(rows: list[tuple[int, int, np.ndarray]], rolls: list[float]) -> list[tuple[str, float]]:
    """Sensor and statistic of each outcome: rows of kind, stamp and numbers, of which those of kind
    TRUTH are decisions with these rolls."""
    values = np.zeros((len(rows), kinds.WIDTH))
    for k, (_, _, numbers) in enumerate(rows):
        values[k, : len(numbers)] = numbers
    block = kinds.Block(
        np.array([kind for kind, _, _ in rows]), np.array([t for _, t, _ in rows]), values, {}
    )
    detector, left, found = NavigationDetector(), iter(rolls), []
    states = detector.new_state().states
    states.sensors["mag"].variance = MODELS["mag"].least_sigma ** 2
    for piece in pieces(block):
        decided, motion = None, None
        if piece.kind == kinds.TRUTH:
            x = np.zeros(X_SIZE)
            x[0], x[6:10] = 6_378_137.0, turned(next(left))[1]
            p = np.zeros((ERROR_SIZE, ERROR_SIZE))
            decided, motion = decision(piece.t_us), MotionEstimate(piece.t_us, x, p, inertial=True)
        results, states = detector._tested(piece, decided, motion, states)
        found += results
    return [(result.sensor, result.statistic or 0.0) for result in found]


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
    states, found = detector.new_state().states, []
    decisions = [decision(0), faulty, None]
    block = kinds.Block(np.array(order), stamps, values, {})
    for piece, decided in zip(pieces(block), decisions, strict=True):
        found, states = detector._tested(piece, decided, motion, states)
    assert [result.reason for result in found] == ["no healthy reference"] * 2
