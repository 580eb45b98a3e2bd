"""Samples to results: the only place where the steps are strung together, live and offline alike.

A step is a frozen set of parameters with `new_state()` and `step(samples, state)`, which gives back
results and the next state; samples come in blocks of any length, one or a whole log.
"""

from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any

import msgspec
import numpy as np

from analysis.detection import DetectorConfig
from analysis.detection.actuators.actuator_detector import ActuatorDetector
from analysis.detection.actuators.actuator_response import CRASH_US, ActuatorResponse
from analysis.detection.actuators.actuator_response import NEVER_US as NEVER_CRASHED_US
from analysis.detection.actuators.alarm_precedence import NEVER_US, apply_precedence
from analysis.detection.actuators.effects import Effects, unknown_effects
from analysis.detection.actuators.imu_hold_out import (
    hold_out_until,
    trusted_rows,
    withdraw_silence,
)
from analysis.detection.actuators.tumble_kernel import new_tumble
from analysis.detection.actuators.tumble_kernel import track_tumble as follow_tumble
from analysis.detection.compass.earth_field_detector import EarthFieldDetector
from analysis.detection.compass.mean_turn_detector import MeanTurnDetector
from analysis.detection.compass.turn_detector import TurnDetector
from analysis.detection.receiver.frozen_fix import FrozenFixDetector
from analysis.detection.sensors.instance_vote import InstanceVoteDetector
from analysis.detection.sensors.jamming_detector import JammingDetector
from analysis.detection.sensors.level_detector import LevelDetector
from analysis.detection.sensors.sensor_tests import NavigationDetector
from analysis.detection.streams.pause_filter import PauseFilter, PauseState, drop_log_gaps
from analysis.detection.streams.stream_detector import StreamDetector
from analysis.fusion.fusion_config import FusionConfig
from analysis.results import Result, SensorDecision
from analysis.samples.block import Block, BlockSlice, block_of, split_at_events
from analysis.samples.sample import Sample
from analysis.scoring.attitude_scores import put_repeaters_last
from analysis.scoring.attitude_scoring import AUTOPILOTS, AttitudeConfig, AttitudeScorer
from mavproxy_fault.documents.document_check import decode
from mavproxy_fault.documents.yaml_document import Document, Lines
from mavproxy_fault.wire.label import Label

WITHOUT_ISOLATION = "fused without isolation"


class MonitorConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The detector with the checks of other sensors, attitude scores, and fusion where wanted.

    `streams` asks for what only a link can do: fall silent, repeat itself, lose its time. `link` is
    whether everything came by one: a log of the autopilot's own pauses when nobody writes it.
    `actuators` is what commands do to the vehicle; where that is not known it is learnt in flight.
    `field_ned_gauss` is the magnetic field of a world that has its own.
    """

    detector: DetectorConfig = DetectorConfig()
    attitude: AttitudeConfig = AttitudeConfig()
    fusion: FusionConfig | None = None
    streams: bool = True
    link: bool = True
    actuators: Effects = unknown_effects()
    field_ned_gauss: tuple[float, float, float] | None = None


class MonitorSection(DetectorConfig, frozen=True, kw_only=True):
    """The `monitor` section of a scenario: the detector's keys, and what else the monitor does.

    A mapping `fusion`, empty or not, switches the fusion on.
    """

    attitude: AttitudeConfig = AttitudeConfig()
    fusion: FusionConfig | None = None


def monitor_config(values: Any, where: str, lines: Lines | None = None) -> MonitorConfig:
    """The `monitor` section of a scenario; `where` and `lines` are those of its file.

    Raises
    ------
    ConfigError
        With every name and value that is not allowed.
    """
    # Below the name that it has in the file: errors then say `monitor.sigma...`.
    document = Document({"monitor": {} if values is None else values}, where, lines or {})
    section = decode(document, MonitorSection, ("monitor",))
    detector = {name: getattr(section, name) for name in DetectorConfig.__struct_fields__}
    return MonitorConfig(
        detector=DetectorConfig(**detector), attitude=section.attitude, fusion=section.fusion
    )


class Pipeline:
    """The steps and their states."""

    def __init__(self, config: MonitorConfig) -> None:
        self._attitude = AttitudeScorer(config.attitude)
        self._attitude_state = self._attitude.new_state()
        self._detector = NavigationDetector(config.detector)
        self._detector_state = self._detector.new_state()
        self._streams = StreamDetector(config.link) if config.streams else None
        self._streams_state = StreamDetector().new_state()
        self._pauses = PauseFilter() if config.streams else None
        self._pauses_state = PauseState()
        self._lost_us: Sequence[tuple[int, int]] = ()
        self._vote = InstanceVoteDetector()
        self._vote_state = self._vote.new_state()
        self._turns = TurnDetector()
        self._turns_state = self._turns.new_state()
        self._mean_turns = MeanTurnDetector()
        self._mean_turns_state = self._mean_turns.new_state()
        self._earth = EarthFieldDetector(config.field_ned_gauss)
        self._earth_state = self._earth.new_state()
        self._levels = LevelDetector()
        self._levels_state = self._levels.new_state()
        self._frozen = FrozenFixDetector()
        self._frozen_state = self._frozen.new_state()
        self._jamming = JammingDetector()
        self._jamming_state = self._jamming.new_state()
        self._actuators = ActuatorDetector(config.actuators)
        self._actuators_state: ActuatorResponse | None = None
        self._tumble = new_tumble()
        self._suspected_us = NEVER_US  # until when the IMU is suspected
        self._imu_us = NEVER_US  # when the IMU was blamed last
        self._fusions: list[Any] = []
        self._feed_back: Any = None
        if config.fusion is not None:
            from analysis.fusion.feedback import feed_back  # GTSAM takes its time to load
            from analysis.fusion.smoother import Fusion

            self._fusions.append(Fusion(config.fusion, config.detector))
            if config.fusion.compare:
                # A second fusion that trusts everything: what isolation gains is seen in one run.
                believing = msgspec.structs.replace(config.fusion, decide=False)
                self._fusions.append(Fusion(believing, config.detector, WITHOUT_ISOLATION))
            self._feed_back = feed_back if config.fusion.feedback else None
        self._fusion_states = [fusion.new_state() for fusion in self._fusions]

    def set_log_gaps(self, lost_us: Sequence[tuple[int, int]]) -> None:
        """Hold silences against nobody in stretches in which a log's writer lost records."""
        self._lost_us = lost_us

    def push(self, samples: Sample | Block) -> list[Result]:
        """What a block of samples, or a single one, leads to."""
        block = samples if isinstance(samples, Block) else block_of(samples)
        return [result for _, result in self.push_rows(block)]

    def push_rows(self, block: Block) -> list[tuple[int, Result]]:
        """The same with the row of the block that led to each."""
        # Whether sensors speak at all, and agree, is looked at apart from what they say.
        troubles = self._troubles(block)
        found = self._detected(block, troubles)
        if self._pauses is not None:
            found, self._pauses_state = self._pauses.step(block, found, self._pauses_state)
            found = drop_log_gaps(found, self._lost_us)
        jammed, self._jamming_state = self._jamming.step(block, self._jamming_state)
        found += troubles + jammed
        obeyed, self._actuators_state = self._actuators.step(block, self._actuators_state)
        found += obeyed
        errors, self._attitude_state = self._attitude.step_rows(block, self._attitude_state)
        found += errors
        # By row, so that results do not hang on how the stream was cut into blocks.
        found.sort(key=itemgetter(0))
        lost = follow_tumble(block.kind, block.t_us, block.values, self._tumble)
        known = self._actuators_state
        if known is not None or lost.any():
            crash_us = int(known.counts[CRASH_US]) if known is not None else NEVER_CRASHED_US
            found, self._imu_us = apply_precedence(found, crash_us, lost, self._imu_us)
        return found

    def _troubles(self, block: Block) -> list[tuple[int, SensorDecision]]:
        """What streams and sensors show by themselves, without the filter."""
        if self._streams is None:
            return []
        troubles, self._streams_state = self._streams.step(block, self._streams_state)
        troubles = drop_log_gaps(troubles, self._lost_us)
        left, self._levels_state = self._levels.step(block, self._levels_state)
        voted, self._vote_state = self._vote.step(block, self._vote_state)
        turned, self._turns_state = self._turns.step(block, self._turns_state)
        drifted, self._mean_turns_state = self._mean_turns.step(block, self._mean_turns_state)
        alien, self._earth_state = self._earth.step(block, self._earth_state)
        frozen, self._frozen_state = self._frozen.step(block, self._frozen_state)
        return troubles + left + voted + turned + drifted + alien + frozen

    def _detected(
        self, block: Block, troubles: list[tuple[int, SensorDecision]]
    ) -> list[tuple[int, Result]]:
        """What the filter finds, or with it the fusion, without an IMU that is suspected."""
        if not len(block.kind):
            return []
        until = hold_out_until(block, troubles, self._suspected_us)
        self._suspected_us = int(until[-1])
        rows = trusted_rows(block, until)
        used = block if rows is None else block.where(np.isin(np.arange(len(until)), rows))
        if self._fusions:
            found = [
                (piece.last, result)
                for piece in split_at_events(used)
                for result in self._fused(piece)
            ]
        else:
            found, self._detector_state = self._detector.step_rows(used, self._detector_state)
        if rows is not None:
            found = [(int(rows[row]), result) for row, result in found]
        return withdraw_silence(found, until) if until[-1] != NEVER_US else found

    def _fused(self, piece: BlockSlice) -> list[Result]:
        """Results with the fused states; with feedback the detector goes on from those."""
        results, self._detector_state = self._detector.step_piece(piece, self._detector_state)
        detector = self._detector_state.detector
        states: list[Result] = []
        for i, fusion in enumerate(self._fusions):
            fused, self._fusion_states[i] = fusion.step_piece(
                piece, results, detector.core, self._fusion_states[i]
            )
            states += fused
        if states and self._feed_back is not None:
            # Of the first fusion: the second is there for comparison only.
            core = self._feed_back(detector.core, self._fusion_states[0].graph)
            detector = detector._replace(core=core)
            self._detector_state = replace(self._detector_state, detector=detector)
        return [*results, *states]

    def attitude(self, labels: Sequence[Label] = ()) -> dict[str, Any]:
        """Scores by estimator; an autopilot that only repeats the truth is called so, and last."""
        scores = self._attitude.summary(self._attitude_state, labels)
        return put_repeaters_last(scores, AUTOPILOTS)
