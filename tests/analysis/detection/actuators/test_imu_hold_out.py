"""An IMU that others have found wrong moves the filter no more."""

import numpy as np

from analysis.detection.actuators.imu_hold_out import (
    HELD_OUT,
    hold_out_until,
    trusted_rows,
    withdraw_silence,
)
from analysis.detection.detector_registry import ENDED_US
from analysis.results import SensorDecision
from analysis.samples.block import NEVER_US, block_of
from analysis.samples.sample import ImuSample, MagSample, Sample


def alarm(t_us: int, reason: str = "", suspect: str = "") -> SensorDecision:
    return SensorDecision(
        t_us=t_us, sensor="imu", statistic=None, threshold=None, dof=0, alarm=True,
        isolated=True, reason=reason, suspect=suspect,
    )  # fmt: skip


def flight() -> list[Sample]:
    """Five seconds of an IMU and a compass, ten a second of each."""
    still = np.zeros(3)
    stamps = range(0, 5_000_000, 100_000)
    return [s for t in stamps for s in (ImuSample(t, still, still), MagSample(t, still))]


def test_imu_samples_are_held_out_until_a_while_after_the_last_alarm() -> None:
    block = block_of(flight())
    until = hold_out_until(block, [(20, alarm(1_000_000)), (30, alarm(1_500_000))], NEVER_US)
    held = ~trusted_rows(block, until)
    assert set(block.kind[held]) == {0}
    assert block.t_us[held].min() == 1_100_000
    assert block.t_us[held].max() == 1_500_000 + ENDED_US - 100_000


def test_an_alarm_before_a_block_holds_the_imu_out_in_it() -> None:
    block = block_of(flight())
    until = hold_out_until(block, [], 300_000)
    assert np.count_nonzero(~trusted_rows(block, until)) == 3
    assert trusted_rows(block, hold_out_until(block, [], NEVER_US)).all()


def test_silence_and_an_ambiguous_compass_do_not_hold_the_imu_out() -> None:
    block = block_of(flight())
    troubles = [(20, alarm(1_000_000, "silent for 0.60 s")), (21, alarm(1, suspect="imu-or-mag"))]
    assert trusted_rows(block, hold_out_until(block, troubles, NEVER_US)).all()


def test_a_held_out_imu_is_not_silent() -> None:
    until = np.array([2_000_000, 2_000_000])
    silent = alarm(1_500_000, "no IMU samples for 0.40 s")
    rows = [(0, silent), (1, alarm(9_000_000))]
    (_, found), (_, later) = withdraw_silence(rows, until, np.full(2, NEVER_US))
    assert isinstance(found, SensorDecision)
    assert (found.alarm, found.reason) == (False, HELD_OUT)
    assert isinstance(later, SensorDecision)
    assert later.alarm
