"""Compile part of the monitor's kernels in a second process, so that the first run uses two cores.

The monitor compiles its kernels in the order of use. This process starts with those it needs last:
it runs attitude scores and sensor tests on synthetic samples, and the monitor then loads the
compiled code from disk. A marker file beside the compiled code shows that this was done.
"""

from contextlib import suppress
from pathlib import Path

import numpy as np

from analysis.monitor.pipeline import MonitorConfig
from mavproxy_fault.numerics.code_cache import folder, installed_folder


def pending_marker() -> Path | None:
    """Return the marker file to create; None if all kernels are compiled."""
    mark = folder() / "rehearsed"
    return None if installed_folder() or mark.exists() else mark


def precompile_kernels(config: MonitorConfig, mark: Path) -> None:
    """Call the kernels of sensor tests and attitude scores with the argument types of a run."""
    _compile_sensor_tests(config)
    _compile_stream_tests()
    _compile_attitude_scores(config)
    with suppress(OSError):  # a read-only cache: the next run compiles again
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()


def _compile_sensor_tests(config: MonitorConfig) -> None:
    from analysis.detection.sensors.sensor_tests import NavigationDetector
    from analysis.samples.sample import BaroSample

    references = NavigationDetector(config.detector)
    references.step(BaroSample(0, 1e5, 0.0), references.new_state())


def _compile_stream_tests() -> None:
    from analysis.detection.streams.stream_detector import StreamDetector
    from analysis.samples.block import block_of
    from analysis.samples.sample import BaroSample

    streams = StreamDetector()
    streams.step(block_of(BaroSample(0, 1e5, 0.0)), streams.new_state())


def _compile_attitude_scores(config: MonitorConfig) -> None:
    from analysis.samples.block import block_of
    from analysis.samples.sample import AttitudeSample, ImuSample, MagSample, TruthSample
    from analysis.scoring.attitude_scoring import AttitudeScorer

    level, still = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    samples = [
        sample
        for t_us in range(0, 1_000_000, 4000)
        # One second of samples runs every branch of the scores.
        for sample in (
            # Specific force at rest points up: negative along the down axis.
            ImuSample(t_us, still, np.array([0.0, 0.0, -9.81]), config.attitude.imu),
            MagSample(t_us, np.array([0.2, 0.0, 0.4])),
            TruthSample(t_us, level, still, 47.0, 8.0, 500.0, still),
            AttitudeSample(t_us, level, 1, "ATTITUDE"),
        )
    ]
    scorer = AttitudeScorer(config.attitude)
    scorer.step(block_of(samples), scorer.new_state())
