"""The navigation filter with its sensor tests, and the fusion where it is wanted, as one step."""

from dataclasses import replace
from typing import Any

import msgspec

from analysis.detection import DetectorConfig
from analysis.detection.sensors.sensor_tests import NavigationDetector, NavigationState
from analysis.fusion.fusion_config import FusionConfig
from analysis.results import Result
from analysis.samples.block import Block, split_at_events

WITHOUT_ISOLATION = "fused without isolation"
FilterState = tuple[NavigationState, list[Any]]  # of the filter, and of each fusion


class FilterStep:
    """A step of the pipeline: the filter's decisions, sensor tests and fused states."""

    def __init__(self, detector: DetectorConfig, fusion: FusionConfig | None) -> None:
        self._navigation = NavigationDetector(detector)
        self._fusions: list[Any] = []
        self._feed_back: Any = None
        if fusion is not None:
            from analysis.fusion.feedback import feed_back  # importing GTSAM takes long
            from analysis.fusion.smoother import Fusion

            self._fusions.append(Fusion(fusion, detector))
            if fusion.compare:
                # A second fusion uses all data: one run then shows what isolation gains.
                undecided = msgspec.structs.replace(fusion, decide=False)
                self._fusions.append(Fusion(undecided, detector, WITHOUT_ISOLATION))
            self._feed_back = feed_back if fusion.feedback else None

    def new_state(self) -> FilterState:
        """The state before the first sample."""
        return self._navigation.new_state(), [fusion.new_state() for fusion in self._fusions]

    def step(
        self, block: Block, state: FilterState
    ) -> tuple[list[tuple[int, Result]], FilterState]:
        """The results of the next samples, each with its row of the block, and the next state."""
        navigation, states = state[0], list(state[1])
        found: list[tuple[int, Result]] = []
        for piece in split_at_events(block):
            results, navigation = self._navigation.step_piece(piece, navigation)
            core, fused = navigation.detector.core, list[Result]()
            for i, fusion in enumerate(self._fusions):
                solutions, states[i] = fusion.step(piece, results, core, states[i])
                fused += solutions
            if fused and self._feed_back is not None:
                # From the first fusion: the second is there for comparison only.
                core = self._feed_back(core, states[0].graph)
                navigation = replace(navigation, detector=navigation.detector._replace(core=core))
            found += [(piece.last, result) for result in (*results, *fused)]
        return found, (navigation, states)
