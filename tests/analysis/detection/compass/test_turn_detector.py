"""Compass and gyro that do not turn alike."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from analysis.detection.compass.turn_detector import TurnDetector
from analysis.results import SensorDecision
from analysis.samples.block import Block, block_of
from analysis.samples.sample import ImuSample, MagSample, Sample

BEGIN_S, END_S, LAST_S = 10.0, 20.0, 30.0
FIELD_GAUSS = np.array([0.2, 0.0, 0.43])
Wrong = Callable[[float], np.ndarray]


def nothing(t_s: float) -> np.ndarray:
    return np.zeros(3)


def flight(
    yaw_rps: float = 0.0,
    *,
    gyro: Wrong = nothing,
    mag: Wrong = nothing,
    iron_gauss: float = 0.0,
    imu_s: float = 0.01,
    noise_gauss: float = 0.002,
) -> Block:
    """A level vehicle that turns at a rate; what is added to gyro and field between two times."""
    rng = np.random.default_rng(1)
    samples: list[Sample] = []
    for k in range(int(LAST_S / imu_s)):
        t_s = k * imu_s
        acting = BEGIN_S <= t_s < END_S
        rates = np.array([0.0, 0.0, yaw_rps]) + (gyro(t_s) if acting else 0.0)
        samples.append(ImuSample(round(t_s * 1e6), rates, np.array([0.0, 0.0, -9.81])))
        if k % max(1, round(0.04 / imu_s)) == 0:
            c, s = np.cos(yaw_rps * t_s), np.sin(yaw_rps * t_s)
            x, y, z = FIELD_GAUSS
            field = np.array([c * x + s * y + iron_gauss, -s * x + c * y, z])
            field += rng.normal(0.0, noise_gauss, 3) + (mag(t_s) if acting else 0.0)
            samples.append(MagSample(round(t_s * 1e6), field))
    return block_of(samples)


def alarms(*blocks: Block) -> list[SensorDecision]:
    detector = TurnDetector()
    state, found = detector.new_state(), []
    for block in blocks:
        results, state = detector.step(block, state)
        found += [result for _, result in results]
    return found


def rates(*rps: float) -> Wrong:
    return lambda t_s: np.array(rps)


@pytest.mark.parametrize("yaw_rps", [0.0, 0.5, -2.0])
@pytest.mark.parametrize("iron_gauss", [0.0, 0.04])
def test_healthy_sensors_raise_no_alarm_with_a_poor_compass(
    yaw_rps: float, iron_gauss: float
) -> None:
    assert alarms(flight(yaw_rps, iron_gauss=iron_gauss, noise_gauss=0.01)) == []


def test_a_gyro_bias_about_the_vertical_raises_an_alarm_and_may_be_the_compass() -> None:
    found = alarms(flight(gyro=rates(0.0, 0.0, 0.1)))
    assert {(r.sensor, r.suspect, r.isolated) for r in found} == {("imu", "imu-or-mag", False)}
    assert 2.0 < found[0].t_s - BEGIN_S <= 4.0


@pytest.mark.parametrize("axis", [0, 1])
def test_a_gyro_that_turns_further_than_any_field_of_this_size_is_isolated(axis: int) -> None:
    wrong = np.zeros(3)
    wrong[axis] = 1.0
    found = alarms(flight(gyro=lambda t_s: wrong))
    assert ("imu", "", True) in {(r.sensor, r.suspect, r.isolated) for r in found}
    assert "mag" not in {r.sensor for r in found}
    assert found[0].t_s - BEGIN_S <= 2.5


@pytest.mark.parametrize(
    "offset_gauss",
    [
        (0.15, 0.0, 0.0),  # of another size
        (-0.058592, 0.191214, 0.0),  # turned by 107 degrees about the vertical, of the same size
    ],
)
def test_a_field_that_jumps_without_a_turn_is_the_compass_fault(
    offset_gauss: tuple[float, float, float],
) -> None:
    found = alarms(flight(mag=rates(*offset_gauss)))
    assert {(r.sensor, r.isolated) for r in found} == {("mag", True)}
    assert found[0].t_s - BEGIN_S <= 2.0


def test_a_frozen_compass_isolates_no_other_sensor() -> None:
    block = flight(1.0)
    rows = block.rows(1)
    frozen = rows[block.t_us[rows] >= BEGIN_S * 1e6]
    block.values[frozen, :3] = block.values[frozen[0], :3]
    assert alarms(block) == []


def test_nothing_is_tested_across_a_pause_of_the_gyro() -> None:
    block = flight(gyro=rates(0.0, 0.0, 0.1))
    pauses = (block.kind == 0) & (block.t_us % 2_000_000 < 300_000)
    kept = np.flatnonzero(~pauses)
    assert alarms(Block(block.kind[kept], block.t_us[kept], block.values[kept], {})) == []
    assert alarms(flight(gyro=rates(0.0, 0.0, 0.1), imu_s=0.2)) == []


@pytest.mark.parametrize(("shakes_rps", "judged"), [(0.0, True), (0.4, False)])
def test_a_slow_gyro_under_vibration_shows_no_turn(shakes_rps: float, judged: bool) -> None:
    """Sampled 25 times a second, vibration looks like a slow turn, which it is not."""
    beat = 2.0 * np.pi * 12.0  # close to half of the rate: a sample is up, the next is down

    def gyro(t_s: float) -> np.ndarray:
        return np.array([shakes_rps * np.sin(beat * t_s), 0.0, 0.1])

    assert bool(alarms(flight(gyro=gyro, imu_s=0.04))) == judged


def test_how_the_stream_is_cut_changes_nothing() -> None:
    block = flight(gyro=rates(0.0, 0.0, 0.3))
    edges = [0, 1, 500, 501, 2000, len(block.kind)]
    parts = [
        Block(block.kind[a:b], block.t_us[a:b], block.values[a:b], {}) for a, b in pairwise(edges)
    ]
    whole = alarms(block)
    assert whole
    assert alarms(*parts) == whole
