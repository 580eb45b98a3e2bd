"""A body that turns faster than its gyro's range."""

from itertools import pairwise

import numpy as np
import pytest

from analysis.detection.actuators.alarm_precedence import TUMBLING, AlarmPrecedence
from analysis.detection.actuators.tumble import TumbleState, track_tumble
from analysis.monitor.pipeline import MonitorConfig, Pipeline
from analysis.results import Decision, SensorDecision
from analysis.samples.block import Block, block_of
from analysis.samples.sample import GpsFix, ImuSample, MagSample, Sample

RANGE_RPS, BEGIN_S, END_S = 4.36, 2.0, 3.0


def flight(
    *, turns: bool = True, jumps: bool = False, blow_s: float = np.inf, error_rps: float = 0.0
) -> Block:
    """A roll that grows to twice the range of the gyro, and is over after a second; then the gyro
    has an error for 20 s."""
    rng = np.random.default_rng(1)
    samples: list[Sample] = []
    angle = 0.0
    for k in range(6_000):
        t_s = k * 0.005
        rate = np.interp(t_s, [BEGIN_S, 2.2, 2.8, END_S], [0.0, 8.0, 8.0, 0.0])
        angle += 0.005 * rate
        shown = RANGE_RPS * (BEGIN_S < t_s < END_S) if jumps else min(rate, RANGE_RPS)
        error = error_rps * (END_S < t_s < END_S + 20.0)
        gyro = np.array([shown, error, 0.0]) + rng.normal(0.0, 0.003, 3)
        force = np.array([0.0, 0.0, -120.0 if abs(t_s - blow_s) < 0.01 else -9.81])
        samples.append(ImuSample(round(t_s * 1e6), gyro, force))
        if k % 8 == 0:
            c, s = (np.cos(angle), np.sin(angle)) if turns else (1.0, 0.0)
            field = np.array([0.2, 0.43 * s, 0.43 * c]) + rng.normal(0.0, 0.003, 3)
            samples.append(MagSample(round(t_s * 1e6), field))
        if k % 40 == 0:
            v_ned = rng.normal(0.0, 0.1, 3)
            samples.append(
                GpsFix(round(t_s * 1e6), 47.0, 8.0, 400.0, v_ned, 3, 12, 1.0, 1.5, "HIL_GPS")
            )
    return block_of(samples)


def lost_s(block: Block) -> np.ndarray:
    return block.t_us[block.t_us < track_tumble(block, TumbleState())] * 1e-6


def test_the_attitude_is_lost_while_the_gyro_is_saturated_and_the_compass_turns() -> None:
    found = lost_s(flight())
    assert 2.1 < found[0] < 2.4
    assert 22.0 < found[-1] < 23.5


def test_an_impact_within_a_tumble_is_a_crash_for_the_rest_of_the_flight() -> None:
    assert lost_s(flight(blow_s=4.0))[-1] == pytest.approx(29.995)


def test_a_saturated_gyro_without_a_turn_of_the_compass_is_faulty() -> None:
    assert not len(lost_s(flight(turns=False, jumps=True)))


def test_how_the_stream_is_cut_changes_nothing() -> None:
    block = flight(blow_s=4.0)
    whole = track_tumble(block, TumbleState())
    kept, edges = TumbleState(), [0, 1, 450, 451, 3000, len(block.kind)]
    parts = [track_tumble(block.between(a, b), kept) for a, b in pairwise(edges)]
    assert (np.concatenate(parts) == whole).all()


def test_what_the_imu_says_while_the_attitude_is_lost_puts_no_receiver_in_doubt() -> None:
    results = Pipeline(MonitorConfig(others={})).push(flight(error_rps=0.1))
    decisions = [one for one in results if isinstance(one, Decision) and one.t_us > 23_500_000]
    assert {one.hypothesis for one in decisions} == {"none"}
    assert len(decisions) > 30


def test_with_a_lost_attitude_no_sensor_is_tested() -> None:
    alarm = SensorDecision(
        t_us=5, sensor="imu", statistic=None, threshold=None, dof=0, alarm=True, isolated=True
    )
    found = AlarmPrecedence({}).apply([(0, alarm), (1, alarm)], 1 << 62, np.array([False, True]))
    assert [(one.alarm, one.reason) for _, one in found] == [(True, ""), (False, TUMBLING)]
