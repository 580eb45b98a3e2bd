"""The monitor's process: signals to all processes of a run, and its own death."""

import os
import signal
import threading
from pathlib import Path

import pytest

from analysis.monitor.pipeline import MonitorConfig
from analysis.processes import fork_context
from analysis.run.monitor_process import MonitorDiedError, MonitorProcess
from analysis.scoring.criteria import Criteria
from mavproxy_fault.wire.tlog import log_record, read_records

RECORDED = Path(__file__).resolve().parents[2] / "data" / "jmavsim" / "hil.tlog"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_request_to_all_processes_does_not_end_the_monitor(number) -> None:
    with MonitorProcess(MonitorConfig()) as monitor:
        os.kill(monitor.pid, number)
        summary = monitor.summary([], Criteria(), 1.0)
    assert "verdict" in summary


def test_a_killed_monitor_is_reported() -> None:
    with MonitorProcess(MonitorConfig()) as monitor:
        os.kill(monitor.pid, signal.SIGKILL)
        with pytest.raises(MonitorDiedError, match="the monitor's process ended by signal 9"):
            monitor.summary([], Criteria(), 1.0)


def test_a_process_with_other_threads_is_not_forked() -> None:
    over = threading.Event()
    thread = threading.Thread(target=over.wait)
    thread.start()
    try:
        assert fork_context() is None
    finally:
        over.set()
        thread.join()


def test_records_give_the_same_results_as_frames() -> None:
    frames = [raw for _, raw, _ in read_records(RECORDED)]
    results = []
    for records in (False, True):
        with MonitorProcess(MonitorConfig(), records=records) as monitor:
            for raw in frames:
                monitor.feed(log_record(0, raw) if records else raw)
            results.append(monitor.results())
    assert results[0] == results[1] != []
