"""IMUs that disagree with others."""

import numpy as np
import pytest

from analysis.detection.sensors.instance_vote import InstanceVote
from analysis.results import SensorDecision
from analysis.samples.block import Block, block_of
from analysis.samples.sample import ImuSample

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


def told(block: Block) -> list[SensorDecision]:
    vote = InstanceVote()
    return [result for _, result in vote.step(block, vote.new_state())[0]]


@pytest.mark.parametrize("bias", [LIGHT, HEAVY], ids=["gyro", "accelerometer"])
@pytest.mark.parametrize("wrong", [0, 1, 2])
def test_one_against_two_is_blamed(wrong: int, bias: np.ndarray) -> None:
    found = told(flight(3, wrong, bias))
    assert {result.reason for result in found} == {f"IMU {wrong + 1} disagrees with the others"}
    assert all(result.isolated for result in found)
    assert WRONG_S[0] * 1e6 < found[0].t_us <= (WRONG_S[0] + 1.5) * 1e6
    assert found[-1].t_us <= (WRONG_S[1] + 1.0) * 1e6


@pytest.mark.parametrize("wrong", [0, 1])
def test_of_two_that_disagree_nobody_is_blamed(wrong: int) -> None:
    found = told(flight(2, wrong))
    assert {result.reason for result in found} == {"IMU 1 and IMU 2 disagree"}
    assert all(result.alarm and not result.isolated for result in found)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_offsets_that_stay_are_no_disagreement(count: int) -> None:
    assert told(flight(count)) == []


def test_the_cut_into_blocks_changes_nothing() -> None:
    whole = flight(3, wrong=1)
    vote = InstanceVote()
    state, one_by_one = vote.new_state(), []
    for row in range(len(whole.kind)):
        found, state = vote.step(whole.between(row, row + 1), state)
        one_by_one += [result for _, result in found]
    assert one_by_one == told(whole)
