"""Sensors that leave their own level: field and fix."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.detection.sensors.level_detector import LevelDetector
from analysis.results import SensorDecision
from analysis.samples.block import Block, block_of
from analysis.samples.sample import GpsFix, ImuSample, MagSample, Sample

CHANGES_S, BACK_S, ENDS_S = 10.0, 15.0, 20.0
FIELD_GAUSS = np.array([0.2, 0.0, 0.43])


def flight(make: Callable[[int, bool], Sample], hz: float = 10.0) -> Block:
    """Samples made of their stamp and whether they are wrong, as those between two times are."""
    stamps = [int(1e6 * k / hz) for k in range(int(ENDS_S * hz))]
    return block_of([make(t_us, CHANGES_S <= t_us * 1e-6 < BACK_S) for t_us in stamps])


def alarms(block: Block) -> list[SensorDecision]:
    detector = LevelDetector()
    return [result for _, result in detector.step(block, detector.new_state())[0]]


def field_of(factor: float, noise_gauss: float = 0.002) -> Callable[[int, bool], Sample]:
    """A field that turns once in ten seconds, and is wrong by a factor."""
    rng = np.random.default_rng(1)

    def make(t_us: int, wrong: bool) -> Sample:
        angle = 2.0 * np.pi * t_us * 1e-7
        level, down = FIELD_GAUSS[0], FIELD_GAUSS[2]
        field = np.array([level * np.cos(angle), level * np.sin(angle), down])
        scale = factor if wrong else 1.0
        return MagSample(t_us, scale * field + rng.normal(0.0, noise_gauss, 3))

    return make


def fix_of(fix_type: int) -> Callable[[int, bool], Sample]:
    def make(t_us: int, wrong: bool) -> Sample:
        kind = fix_type if wrong else 3
        return GpsFix(t_us, 47.0, 8.0, 500.0, None, kind, 12, 1.0, 1.0, "HIL_GPS")

    return make


@pytest.mark.parametrize(
    ("make", "sensor"),
    [
        (field_of(1.3), "mag"),
        (field_of(0.8), "mag"),
        (fix_of(2), "gps-position"),
    ],
)
def test_a_sensor_is_isolated_while_it_is_off_its_level(
    make: Callable[[int, bool], Sample], sensor: str
) -> None:
    found = alarms(flight(make))
    assert {result.sensor for result in found} == {sensor}
    assert all(result.isolated for result in found)
    assert 300_000 <= found[0].t_us - CHANGES_S * 1e6 < 1_000_000
    assert -600_000 < found[-1].t_us - BACK_S * 1e6 < 1_000_000


@pytest.mark.parametrize("make", [field_of(1.05), fix_of(4)])
def test_small_changes_isolate_no_sensor(make: Callable[[int, bool], Sample]) -> None:
    assert alarms(flight(make)) == []


@pytest.mark.parametrize("block_s", [0.1, 1.0, 20.0])
@pytest.mark.parametrize(("rate_rps", "found_isolated"), [(28.0, False), (0.1, True)])
def test_a_field_averaged_away_by_a_tumble_is_no_fault(
    rate_rps: float, found_isolated: bool, block_s: float
) -> None:
    # As a falling hexacopter was logged: 25 samples of the gyro a second, some ten of the compass.
    make, samples = field_of(0.8), list[Sample]()
    for k in range(500):
        t_us = k * 40_000
        tumbles = CHANGES_S <= t_us * 1e-6 < CHANGES_S + 1.5
        rates = np.array([rate_rps if tumbles else 0.1, 0.0, 0.0])
        samples.append(ImuSample(t_us, rates, np.array([0.0, 0.0, -9.81])))
        if k % 3 == 0:
            samples.append(make(t_us, tumbles))
    detector = LevelDetector()
    state, found = detector.new_state(), []
    for first in range(0, len(samples), n := round(block_s * 33)):
        found += detector.step(block_of(samples[first : first + n]), state)[0]
    assert bool(found) == found_isolated


def test_a_noisy_field_has_to_change_by_more() -> None:
    assert alarms(flight(field_of(1.15, noise_gauss=0.1))) == []


def test_a_lasting_level_becomes_the_usual_one() -> None:
    stamps = range(0, 60_000_000, 100_000)
    block = block_of([fix_of(2)(t_us, t_us > 10_000_000) for t_us in stamps])
    assert 29.0 < alarms(block)[-1].t_us * 1e-6 < 31.0


@pytest.mark.parametrize("lasts_s", [20.1, 20.3, 25.0, 40.0])
def test_a_return_from_a_level_that_became_usual_is_no_new_step(lasts_s: float) -> None:
    make, begin_s = field_of(1.3), 10.0
    stamps = range(0, 90_000_000, 20_000)
    block = block_of([make(t_us, begin_s <= t_us * 1e-6 < begin_s + lasts_s) for t_us in stamps])
    found = alarms(block)
    assert found[0].t_us * 1e-6 < begin_s + 1.0
    assert found[-1].t_us * 1e-6 < begin_s + 20.6


def test_the_cut_into_blocks_changes_nothing() -> None:
    whole = flight(field_of(1.3))
    detector = LevelDetector()
    state, one_by_one = detector.new_state(), []
    for row in range(len(whole.kind)):
        found, state = detector.step(whole.between(row, row + 1), state)
        one_by_one += [result for _, result in found]
    assert one_by_one == alarms(whole)


def test_an_autopilots_own_report_of_the_fix_hides_no_loss() -> None:
    """ArduPilot's GPS_RAW_INT has another clock, which would begin the level anew each time."""
    samples: list[Sample] = []
    for t_us in range(0, 30_000_000, 200_000):
        fix = fix_of(0)(t_us, t_us > 20_000_000)
        samples.append(replace(fix, source="HIL_GPS"))
        if t_us % 400_000 == 0:
            samples.append(replace(fix, t_us=t_us + 1_700_000_000_000_000, source="GPS_RAW_INT"))
    found = alarms(block_of(samples))
    assert found
    assert found[0].t_us < 21_000_000
