"""Samples to results: the monitor's detectors, listed in one place and run in order.

A step is a frozen set of parameters with `new_state()` and `step(block, state)`, which returns
results and the next state; blocks may have any length, from one sample to a complete log.
"""

from collections.abc import Sequence
from operator import itemgetter
from typing import Any

import msgspec
import numpy as np

from analysis.detection import DetectorConfig
from analysis.detection.actuators.actuator_detector import ActuatorDetector
from analysis.detection.actuators.alarm_precedence import AlarmPrecedence
from analysis.detection.actuators.effects import Effects, unknown_effects
from analysis.detection.actuators.imu_hold_out import hold_out_until, trusted_rows, withdraw_silence
from analysis.detection.actuators.tumble import TumbleState, track_tumble
from analysis.detection.compass.earth_field_detector import EarthFieldDetector
from analysis.detection.compass.mean_turn_detector import MeanTurnDetector
from analysis.detection.compass.turn_detector import TurnDetector
from analysis.detection.detector_registry import BlockDetector, other_detectors
from analysis.detection.receiver.receiver_or_imu import UNDECIDED
from analysis.detection.sensors.instance_vote import InstanceVoteDetector
from analysis.detection.sensors.jamming_detector import JammingDetector
from analysis.detection.sensors.level_detector import LevelDetector
from analysis.detection.streams.pause_filter import PauseState, drop_log_gaps, track_pauses
from analysis.detection.streams.stream_detector import StreamDetector
from analysis.fusion.fusion_config import FusionConfig
from analysis.monitor.filter_step import FilterStep
from analysis.results import FOREVER_US, Result, SensorDecision
from analysis.samples.block import NEVER_US, Block, Stamps, block_of
from analysis.samples.sample import Sample
from analysis.scoring.attitude_scores import put_repeaters_last
from analysis.scoring.attitude_scoring import AUTOPILOTS, AttitudeConfig, AttitudeScorer
from mavproxy_fault.documents.document_check import decode
from mavproxy_fault.documents.yaml_document import Document, Lines
from mavproxy_fault.wire.label import Label

FILTER, ACTUATORS = "filter", "actuators"


class MonitorConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The navigation filter's parameters, attitude scores, fusion, and the other detectors.

    `streams` switches the tests of what only a link can do: silence, repetition, wrong timestamps.
    `link` says whether all samples came over a link: an autopilot's own log pauses as a whole.
    `actuators` are the vehicle's effects; unknown ones are learned in flight. `field_ned_gauss` is
    the magnetic field of a simulated world. `others` are other packages' detectors by name.
    """

    detector: DetectorConfig = DetectorConfig()
    attitude: AttitudeConfig = AttitudeConfig()
    fusion: FusionConfig | None = None
    streams: bool = True
    link: bool = True
    actuators: Effects = unknown_effects()
    field_ned_gauss: tuple[float, float, float] | None = None
    others: dict[str, Any] = msgspec.field(
        default_factory=lambda: {name: kind() for name, kind in other_detectors().items()}
    )


def monitor_detectors(config: MonitorConfig) -> dict[str, BlockDetector]:
    """Every detector but the filter by name, in the order of their results; ours win by name."""
    own: dict[str, BlockDetector] = {
        "streams": StreamDetector(config.link),
        "levels": LevelDetector(),
        "instances": InstanceVoteDetector(),
        "turns": TurnDetector(),
        "mean-turns": MeanTurnDetector(),
        "earth-field": EarthFieldDetector(config.field_ned_gauss),
        "jamming": JammingDetector(),
        ACTUATORS: ActuatorDetector(config.actuators),
    }
    if not config.streams:
        del own["streams"]
    return {**own, **{name: other for name, other in config.others.items() if name not in own}}


class MonitorSection(DetectorConfig, frozen=True, kw_only=True):
    """The `monitor` section of a scenario: the filter's keys, and the monitor's further settings.

    A mapping `fusion`, empty or not, switches the fusion on. Other packages' detectors add their
    names.
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
    kinds = {name: (name.replace("-", "_"), kind) for name, kind in other_detectors().items()}
    fields = [(key, kind, msgspec.field(default_factory=kind)) for key, kind in kinds.values()]
    section: Any = decode(
        document,
        msgspec.defstruct("Section", fields, bases=(MonitorSection,), frozen=True, kw_only=True),
        ("monitor",),
    )
    detector = {name: getattr(section, name) for name in DetectorConfig.__struct_fields__}
    return MonitorConfig(
        detector=DetectorConfig(**detector),
        attitude=section.attitude,
        fusion=section.fusion,
        others={name: getattr(section, key) for name, (key, _) in kinds.items()},
    )


class Pipeline:
    """The steps and their states; `alarms` are those of each detector before `AlarmPrecedence`."""

    def __init__(self, config: MonitorConfig) -> None:
        self._attitude = AttitudeScorer(config.attitude)
        self._attitude_state = self._attitude.new_state()
        self._filter = FilterStep(config.detector, config.fusion)
        self._detectors = monitor_detectors(config)
        steps: dict[str, Any] = {FILTER: self._filter, **self._detectors}
        self.states = {name: step.new_state() for name, step in steps.items()}
        self.alarms: dict[str, list[SensorDecision]] = {name: [] for name in self._detectors}
        self._pauses = PauseState() if config.streams else None
        self._lost_us: Sequence[tuple[int, int]] = ()
        self._tumble = TumbleState()
        self._held_out_us = NEVER_US  # until when the filter does without the IMU
        # What the actuators are tested with; the effects of wings depend on the airspeed.
        sources = ["imu", UNDECIDED, *(["airspeed"] if config.actuators.powers.any() else [])]
        self._precedence = AlarmPrecedence(dict.fromkeys(sources, NEVER_US))

    def set_log_gaps(self, lost_us: Sequence[tuple[int, int]]) -> None:
        """Ignore silences during and just after times in which a log's writer lost records."""
        self._lost_us = lost_us

    def push(self, samples: Sample | Block) -> list[Result]:
        """The results of a block of samples, or of a single one."""
        return [result for _, result in self.push_rows(block_of(samples))]

    def push_rows(self, block: Block) -> list[tuple[int, Result]]:
        """The results of a block, each with the row of the block that led to it."""
        found: list[tuple[int, SensorDecision]] = []
        for name, detector in self._detectors.items():
            rows, self.states[name] = detector.step(block, self.states[name])
            rows = drop_log_gaps(rows, self._lost_us)
            self.alarms[name] += [result for _, result in rows if result.alarm]
            found += rows
        tumble_us = track_tumble(block, self._tumble)
        results = drop_log_gaps(self._filtered(block, found, tumble_us), self._lost_us)
        errors, self._attitude_state = self._attitude.step(block, self._attitude_state)
        results += [*found, *errors]
        # By row, so that results do not depend on how the stream was cut into blocks.
        results.sort(key=itemgetter(0))
        lost = block.t_us < tumble_us
        actuators = self.states[ACTUATORS]
        if actuators is not None or lost.any():
            crash_us = FOREVER_US if actuators is None else actuators.crash_us
            results = self._precedence.apply(results, crash_us, lost)
        return results

    def _filtered(
        self, block: Block, found: Sequence[tuple[int, SensorDecision]], tumble_us: Stamps
    ) -> list[tuple[int, Result]]:
        """The filter's results, without the IMU while a detector has `found` it faulty, or while
        the attitude is lost."""
        if not len(block.kind):
            return []
        until = np.maximum(hold_out_until(block, found, self._held_out_us), tumble_us)
        self._held_out_us = int(until[-1])
        trusted = trusted_rows(block, until)
        used = block if trusted.all() else block.where(trusted)
        results, self.states[FILTER] = self._filter.step(used, self.states[FILTER])
        rows = np.flatnonzero(trusted)
        results = [(int(rows[row]), result) for row, result in results]
        paused = np.full(len(until), NEVER_US)
        if self._pauses is not None:
            paused = track_pauses(block, self._pauses)
        return withdraw_silence(results, until, paused)

    def attitude(self, labels: Sequence[Label] = ()) -> dict[str, Any]:
        """Scores by estimator; an autopilot that only repeats the truth is marked and put last."""
        scores = self._attitude.summary(self._attitude_state, labels)
        return put_repeaters_last(scores, AUTOPILOTS)
