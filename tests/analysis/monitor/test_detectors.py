"""The list of detectors that the monitor runs."""

from analysis.detection.detector_registry import BlockDetector
from analysis.monitor.pipeline import MonitorConfig, Pipeline, monitor_detectors
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import BARO, Block, block_of
from analysis.samples.sample import BaroSample
from analysis.scoring.fault_channels import SATELLITES, SENSOR_VISIBILITY


class Noisy(BlockDetector, frozen=True):
    """An alarm for every sample of the barometer; the state counts them."""

    def new_state(self) -> int:
        return 0

    def step(self, block: Block, state: int) -> tuple[list[tuple[int, SensorDecision]], int]:
        rows = block.rows(BARO).tolist()
        return [(row, pattern_alarm(int(block.t_us[row]), "noisy", "noise")) for row in rows], (
            state + len(rows)
        )


def test_the_channels_of_every_built_in_detector_are_known_to_the_score() -> None:
    known = {*SENSOR_VISIBILITY, SATELLITES, "gps-position", "actuators"}
    for detector in monitor_detectors(MonitorConfig(others={})).values():
        assert detector.channels
        assert detector.channels <= known


def test_a_built_in_detector_wins_over_another_of_its_name() -> None:
    detectors = monitor_detectors(MonitorConfig(others={"levels": Noisy(), "noisy": Noisy()}))
    assert not isinstance(detectors["levels"], Noisy)
    assert list(detectors)[-1] == "noisy"


def test_another_packages_results_follow_those_of_the_built_in_ones_by_row() -> None:
    blocks = [block_of([BaroSample(t_us, 1e5, 0.0)]) for t_us in range(0, 1_000_000, 20_000)]
    plain = Pipeline(MonitorConfig(others={}))
    more = Pipeline(MonitorConfig(others={"noisy": Noisy()}))
    without = [result for block in blocks for result in plain.push(block)]
    results = [result for block in blocks for result in more.push(block)]
    assert [r for r in results if getattr(r, "sensor", "") != "noisy"] == without
    assert more.states["noisy"] == len(blocks) == len(more.alarms["noisy"])
