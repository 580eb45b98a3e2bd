"""The kernels compiled in parallel are those that the monitor calls."""

from analysis.detection.sensors.sensor_kernel import run_sensor_tests
from analysis.monitor.pipeline import MonitorConfig, Pipeline
from analysis.run.kernel_precompilation import precompile_kernels
from analysis.scoring.attitude_kernel import accumulate_errors, score_estimates


def signatures():
    return [
        set(kernel.signatures) for kernel in (run_sensor_tests, score_estimates, accumulate_errors)
    ]


def test_a_flight_needs_only_precompiled_kernels(flights, tmp_path):
    precompile_kernels(MonitorConfig(), tmp_path / "mark")
    rehearsed = signatures()
    pipeline = Pipeline(MonitorConfig())
    for sample in flights(2.0):
        pipeline.push(sample)
    assert signatures() == rehearsed
    assert (tmp_path / "mark").exists()
