"""An IMU that is silent, alone and while everything pauses."""

import numpy as np
import pytest

from analysis.detection.streams.pause_filter import IMU_SILENT
from analysis.monitor.pipeline import MonitorConfig, Pipeline
from analysis.results import SensorDecision
from analysis.samples.block import IMU, Block, block_of
from analysis.samples.sample import BaroSample, GpsFix, ImuSample, MagSample, Sample

PAUSE_US = (12_010_000, 12_390_000)  # from a fix on, until just before the next but one


def flight(silent: tuple[type, ...]) -> Block:
    """A vehicle at rest; some of its sensors are silent for a while."""
    rng = np.random.default_rng(5)
    samples: list[Sample] = []
    for tick in range(1_600):
        t_us = tick * 10_000
        force = np.array([0.0, 0.0, -9.81]) + rng.normal(0.0, 0.02, 3)
        now: list[Sample] = [ImuSample(t_us, rng.normal(0.0, 1e-3, 3), force)]
        if tick % 5 == 0:
            now.append(BaroSample(t_us, 95_000.0 + rng.normal(0.0, 2.0), 0.0))
            now.append(MagSample(t_us, np.array([0.21, 0.01, 0.43]) + rng.normal(0.0, 1e-3, 3)))
        if tick % 20 == 0:
            v_ned_mps = rng.normal(0.0, 0.05, 3)
            now.append(GpsFix(t_us, 47.0, 8.0, 500.0, v_ned_mps, 3, 12, 1.0, 1.5, "HIL_GPS"))
        pauses = PAUSE_US[0] <= t_us < PAUSE_US[1]
        samples += [one for one in now if not (pauses and isinstance(one, silent))]
    return block_of(samples)


def silences(*blocks: Block) -> list[SensorDecision]:
    pipeline = Pipeline(MonitorConfig(link=False))
    found = [result for block in blocks for result in pipeline.push(block)]
    alarms = [one for one in found if isinstance(one, SensorDecision) and one.alarm]
    return [one for one in alarms if one.reason.startswith(IMU_SILENT)]


def test_an_imu_that_alone_is_silent_raises_an_alarm() -> None:
    assert silences(flight((ImuSample,)))


@pytest.mark.parametrize("length", [1, 7, 10_000])
def test_no_stream_is_silent_while_everything_pauses(length: int) -> None:
    whole = flight((ImuSample, BaroSample, MagSample, GpsFix))
    count = len(whole.kind)
    parts = [whole.between(i, min(i + length, count)) for i in range(0, count, length)]
    assert silences(*parts) == []


def test_a_slowly_logged_imu_is_not_isolated_for_three_missing_samples() -> None:
    whole = flight(())
    slow = (whole.kind != IMU) | (whole.t_us % 40_000 == 0)
    missing = (whole.kind == IMU) & (whole.t_us > 12_010_000) & (whole.t_us < 12_160_000)
    assert silences(whole.where(slow & ~missing)) == []


@pytest.mark.parametrize(("lost_us", "alarm"), [((), True), (((12_000_000, 13_000_000),), False)])
def test_no_stream_is_silent_while_a_logger_loses_records(
    lost_us: tuple[tuple[int, int], ...], alarm: bool
) -> None:
    pipeline = Pipeline(MonitorConfig(link=False))
    pipeline.set_log_gaps(lost_us)
    found = pipeline.push(flight((ImuSample,)))
    assert any(isinstance(one, SensorDecision) and one.alarm for one in found) == alarm
