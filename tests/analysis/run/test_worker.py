"""The monitor's process: signals to all of a run's processes, and its own death."""

import os
import signal

import pytest

from analysis.monitor.pipeline import MonitorConfig
from analysis.run.worker import MonitorDiedError, MonitorProcess
from analysis.scoring.criteria import Criteria


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_request_to_stop_that_reaches_every_process_leaves_the_monitor_its_work(number) -> None:
    with MonitorProcess(MonitorConfig()) as monitor:
        os.kill(monitor.pid, number)
        summary = monitor.summary([], Criteria(), 1.0)
    assert "verdict" in summary


def test_a_monitor_that_was_killed_is_told() -> None:
    with MonitorProcess(MonitorConfig()) as monitor:
        os.kill(monitor.pid, signal.SIGKILL)
        with pytest.raises(MonitorDiedError, match="the monitor's process ended by signal 9"):
            monitor.summary([], Criteria(), 1.0)
