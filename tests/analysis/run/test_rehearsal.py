"""What is compiled beside the monitor is what the monitor calls."""

from analysis.detection.sensors.sensor_kernel import judge
from analysis.monitor.pipeline import MonitorConfig, Pipeline
from analysis.run.rehearsal import rehearse
from analysis.scoring.attitude_kernel import compare, gather


def signatures():
    return [set(kernel.signatures) for kernel in (judge, compare, gather)]


def test_a_flight_needs_no_kernel_that_was_not_rehearsed(flights, tmp_path):
    rehearse(MonitorConfig(), tmp_path / "mark")
    rehearsed = signatures()
    pipeline = Pipeline(MonitorConfig())
    for sample in flights(2.0):
        pipeline.push(sample)
    assert signatures() == rehearsed
    assert (tmp_path / "mark").exists()
