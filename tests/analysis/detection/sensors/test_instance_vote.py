"""Sensors that disagree with others of their kind."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.detection.sensors.instance_vote import InstanceVoteDetector
from analysis.results import SensorDecision
from analysis.samples.block import BARO, FIX, IMU_ID, MAG, Block, block_of
from analysis.samples.sample import (
    BaroSample,
    GpsFix,
    ImuSample,
    MagSample,
    Sample,
    SpareSample,
)

HZ, ENDS_S, WRONG_S = 50, 20.0, (10.0, 15.0)
LIGHT = np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])  # biases, rad/s and m/s^2
HEAVY = np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0])


def flight(count: int, wrong: int | None = None, bias: np.ndarray = HEAVY) -> Block:
    """`count` IMUs with offsets of their own in one motion; one of them may get a bias."""
    rng = np.random.default_rng(2)
    samples = []
    for k in range(int(ENDS_S * HZ)):
        t_s = k / HZ
        motion = np.array([np.sin(t_s), 0.0, 0.5, 2.0 * np.cos(3.0 * t_s), 0.0, -9.8])
        for number in range(count):
            felt = motion + 0.1 * number + rng.normal(0.0, 0.02, 6)
            if number == wrong and WRONG_S[0] <= t_s < WRONG_S[1]:
                felt = felt + bias
            samples.append(ImuSample(int(t_s * 1e6), felt[:3], felt[3:], number))
    return block_of(samples)


def alarms(block: Block) -> list[SensorDecision]:
    vote = InstanceVoteDetector()
    return [result for _, result in vote.step(block, vote.new_state())[0]]


@pytest.mark.parametrize("bias", [LIGHT, HEAVY], ids=["gyro", "accelerometer"])
@pytest.mark.parametrize("wrong", [0, 1, 2])
def test_a_sensor_that_disagrees_with_two_is_isolated(wrong: int, bias: np.ndarray) -> None:
    found = alarms(flight(3, wrong, bias))
    assert {result.reason for result in found} == {f"IMU {wrong + 1} disagrees with the others"}
    assert all(result.isolated for result in found)
    assert WRONG_S[0] * 1e6 < found[0].t_us <= (WRONG_S[0] + 1.5) * 1e6
    assert found[-1].t_us <= (WRONG_S[1] + 1.0) * 1e6


@pytest.mark.parametrize("wrong", [0, 1])
def test_of_two_that_disagree_none_is_isolated(wrong: int) -> None:
    found = alarms(flight(2, wrong))
    assert {result.reason for result in found} == {"IMU 1 and IMU 2 disagree"}
    assert all(result.alarm and not result.isolated for result in found)


@pytest.mark.parametrize("count", [2, 3])
def test_a_sensor_that_alone_becomes_noisy_is_isolated(count: int) -> None:
    block, rng = flight(count), np.random.default_rng(4)
    noisy = (block.t_us > WRONG_S[0] * 1e6) & (block.t_us < WRONG_S[1] * 1e6)
    noisy &= block.values[:, IMU_ID] == 1
    block.values[noisy, :3] += rng.normal(0.0, 0.3, (int(noisy.sum()), 3))
    found = alarms(block)
    assert {result.reason for result in found} == {"IMU 2 is noisy, unlike the others"}
    assert all(result.isolated for result in found)
    assert WRONG_S[0] * 1e6 < found[0].t_us <= (WRONG_S[0] + 2.0) * 1e6


@pytest.mark.parametrize("count", [1, 2, 3])
def test_constant_offsets_are_no_disagreement(count: int) -> None:
    assert alarms(flight(count)) == []


def test_imus_under_vibration_do_not_disagree() -> None:
    """Each is sampled at other instants of a vibration that is far from what they are used to."""
    rng = np.random.default_rng(3)
    block = flight(2)
    shaken = (block.t_us > WRONG_S[0] * 1e6) & (block.t_us < WRONG_S[1] * 1e6)
    block.values[shaken, 3:6] += rng.normal(0.0, 20.0, (int(shaken.sum()), 3))
    assert alarms(block) == []


def test_the_cut_into_blocks_changes_nothing() -> None:
    whole = flight(3, wrong=1)
    vote = InstanceVoteDetector()
    state, one_by_one = vote.new_state(), []
    for row in range(len(whole.kind)):
        found, state = vote.step(whole.between(row, row + 1), state)
        one_by_one += [result for _, result in found]
    assert one_by_one == alarms(whole)


NUMBERS = {
    MAG: np.array([0.2, 0.0, 0.43]),
    BARO: np.array([95_000.0, np.nan, 0.0]),
    FIX: np.array([47.0, 8.0, 500.0]),
}
FAULTS = {
    MAG: np.array([0.15, 0.0, 0.0]),
    BARO: np.array([100.0, 0.0, 0.0]),  # 8 m
    FIX: np.array([0.0, 50.0 / 76_000.0, 0.0]),  # 50 m east
}
NAMES = {
    MAG: ("mag", "magnetometer"),
    BARO: ("baro", "barometer"),
    FIX: ("gps-position", "receiver"),
}


def of(kind: int, t_us: int, number: int, numbers: np.ndarray) -> Sample:
    """The first sensor of a kind, or a further one."""
    if number:
        return SpareSample(t_us, kind, number, numbers)
    if kind == MAG:
        return MagSample(t_us, numbers)
    if kind == BARO:
        return BaroSample(t_us, numbers[0], np.nan)
    return GpsFix(t_us, *numbers.tolist(), None, 3, 12, 1.0, 1.0, "GPS_RAW_INT")


def doubled(kind: int, count: int, wrong: int | None) -> Block:
    rng = np.random.default_rng(3)
    spread = np.abs(FAULTS[kind]) / 100.0
    samples = []
    for k in range(300):
        t_s = 0.1 * k
        for number in range(count):
            felt = NUMBERS[kind] + number * spread * 10.0 + rng.normal(0.0, 1.0, 3) * spread
            if number == wrong and WRONG_S[0] + 5.0 <= t_s < WRONG_S[1] + 8.0:
                felt = felt + FAULTS[kind]
            samples.append(of(kind, round(t_s * 1e6) + number, number, felt))
    return block_of(samples)


@pytest.mark.parametrize("kind", [MAG, BARO])
@pytest.mark.parametrize("wrong", [0, 1, 2])
def test_the_faulty_one_of_three_mags_or_barometers_is_named(kind: int, wrong: int) -> None:
    channel, name = NAMES[kind]
    found = alarms(doubled(kind, 3, wrong))
    assert {(r.sensor, r.reason, r.isolated) for r in found} == {
        (channel, f"{name} {wrong + 1} disagrees with the others", True)
    }
    assert found[0].t_us * 1e-6 <= WRONG_S[0] + 5.0 + 3.1


@pytest.mark.parametrize("kind", [MAG, BARO])
@pytest.mark.parametrize("wrong", [0, 1])
def test_of_two_that_disagree_both_are_named_and_none_is_isolated(kind: int, wrong: int) -> None:
    channel, name = NAMES[kind]
    found = alarms(doubled(kind, 2, wrong))
    assert {(r.sensor, r.reason, r.isolated) for r in found} == {
        (channel, f"{name} 1 and {name} 2 disagree", False)
    }


def test_two_receivers_that_diverge_raise_an_alarm() -> None:
    once = list(doubled(FIX, 2, None).samples())
    # Ten windows of two seconds are learnt first.
    longer = [replace(s, t_us=s.t_us + lap * 30_000_000) for lap in range(4) for s in once]
    assert alarms(block_of(longer)) == []
    parted = [
        moved(sample) if sample.t_us > 100_000_000 and isinstance(sample, SpareSample) else sample
        for sample in longer
    ]
    found = alarms(block_of(parted))
    assert {(r.sensor, r.reason) for r in found} == {
        ("gps-position", "receiver 1 and receiver 2 disagree")
    }


def moved(sample: SpareSample) -> SpareSample:
    return replace(sample, numbers=sample.numbers[:3] + FAULTS[FIX])


@pytest.mark.parametrize("kind", [MAG, BARO, FIX])
def test_additional_sensors_that_agree_raise_no_alarm(kind: int) -> None:
    assert alarms(doubled(kind, 3, None)) == []


@pytest.mark.parametrize("silent", [1, 2])
def test_an_additional_magnetometer_that_falls_silent_raises_an_alarm(silent: int) -> None:
    rng = np.random.default_rng(2)
    samples: list[Sample] = []
    for k in range(int(ENDS_S * 10)):
        t_us = k * 100_000
        for number in range(3):
            if number == silent and WRONG_S[0] <= t_us * 1e-6 < WRONG_S[1]:
                continue
            field = np.array([0.2, 0.0, 0.4]) + rng.normal(0.0, 0.002, 3)
            spare = SpareSample(t_us, MAG, number, field)
            samples.append(MagSample(t_us, field) if number == 0 else spare)
    found = alarms(block_of(samples))
    assert {result.sensor for result in found} == {"mag"}
    assert found[0].reason == f"silent for 3 s: magnetometer {silent + 1}"
    assert WRONG_S[0] + 3.0 <= found[0].t_s <= WRONG_S[0] + 4.0
    assert found[-1].t_s <= WRONG_S[1] + 1.0
