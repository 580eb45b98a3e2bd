"""The other sensors against the navigation filter.

Barometer, airspeed, magnetometer, vision, range, and a receiver's own position and velocity.

While the detector finds the IMU (or at least the satellites) sound, its filter is the reference.
Every sensor is tested at each GNSS epoch with its newest sample: innovation v, what the filter and
the sensor's own slow states (an offset, the wind, the local field) leave uncertain of it, and

    v' inv(H_b P_b H_b' + R) v  against chi-square(m),

with a false-alarm probability of its own (`p_other`). A sensor that fails several times running is
isolated until it has been healthy for `readmit_s`; its slow states stand still meanwhile. How each
is predicted is in `reference_models`.

`References` contains the detector: its results are the detector's and the sensors' together, so a
pipeline holds either a `Detector` or a `References`.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from analysis import block as kinds
from analysis.block import WIDTH, Block, Piece, Stamps, pieces
from analysis.fdi.config import DetectorConfig
from analysis.fdi.core import State
from analysis.fdi.detector import Detector
from analysis.fdi.thresholds import chi_square
from analysis.reference_kernel import (
    HEALTHY_US,
    ISOLATED,
    NEVER_US,
    SLOW_US,
    STALE_US,
    Counts,
    judge,
)
from analysis.reference_models import (
    GPS_POSITION,
    GPS_VELOCITY,
    NOTHING,
    REASONS,
    SENSORS,
    TESTED,
    SensorNoise,
)
from analysis.results import Decision, Result, SensorDecision
from analysis.samples import Sample, Vector

FIX_OF_EPOCH_S = 0.01
STALE_S = STALE_US * 1e-6  # older samples are not tested
GPS = (GPS_POSITION, GPS_VELOCITY)
NO_SAMPLES = np.full(len(SENSORS), NEVER_US)
SOUND = ("none", "satellites", "clock", "gps")
_ORDER = (kinds.MAG, kinds.BARO, kinds.AIRSPEED, kinds.RANGE, kinds.VISION)  # as in SENSORS
NUMBER_OF = {kind: number for number, kind in enumerate(_ORDER)}


@dataclass(frozen=True, slots=True)
class ReferenceState:
    """The detector's state, the newest decision, and of each of s sensors the newest sample since
    then, `stamps` (s,) and `values` (s, WIDTH), what is counted (s, 4) and its slow states (s, 12).
    """

    detector: State
    stamps: Stamps
    values: Vector
    counts: Counts
    slow: Vector
    decision: Decision | None = None


@dataclass(frozen=True)
class References:
    """The detector and the tests of the other sensors against it."""

    config: DetectorConfig = field(default_factory=DetectorConfig)
    sensors: SensorNoise = field(default_factory=SensorNoise)

    @cached_property
    def detector(self) -> Detector:
        """The detector whose filter is the reference."""
        return Detector(self.config)

    @cached_property
    def _thresholds(self) -> Vector:
        return np.array([0.0, *(chi_square(dof, self.config.p_other) for dof in (1, 2, 3))])

    @cached_property
    def _noise(self) -> tuple[Vector, Vector]:
        return self.sensors.sigmas(), self.sensors.walks()

    def new_state(self) -> ReferenceState:
        """Nothing known."""
        count = len(SENSORS)
        counts = np.zeros((count, 4), np.int64)
        counts[:, [SLOW_US, HEALTHY_US]] = NEVER_US
        values, slow = np.zeros((count, WIDTH)), np.zeros((count, 12))
        return ReferenceState(self.detector.new_state(), NO_SAMPLES, values, counts, slow)

    def step(
        self, samples: Sample | Block, state: ReferenceState
    ) -> tuple[list[Result], ReferenceState]:
        """Decisions that a block of samples, or a single one, allows, and the next state."""
        results: list[Result] = []
        for piece in pieces(samples):
            said, state = self.take(piece, state)
            results += said
        return results, state

    def take(self, piece: Piece, state: ReferenceState) -> tuple[list[Result], ReferenceState]:
        """The same for samples up to an event."""
        stamps, values = _with_newest(piece, state.stamps, state.values)
        results, detector = self.detector.take(piece, state.detector)
        decision = next((r for r in results if isinstance(r, Decision)), None)
        if decision is None and piece.kind == kinds.FIX:
            decision = _of_same_instant(state.decision, piece.t_us)
        counts, slow = state.counts, state.slow
        if decision is None or decision.mode == "":
            return results, ReferenceState(detector, stamps, values, counts, slow, state.decision)
        if decision.mode.startswith("position"):
            stamps[list(GPS)] = NEVER_US  # the fix is the filter's own input
        motion = detector.core.motion
        if motion is None or decision.hypothesis not in SOUND:
            results += _without_reference(decision, stamps, counts)
        else:
            said, counts, slow = judge(
                motion.x,
                motion.p,
                motion.inertial,
                decision.t_us,
                stamps,
                values,
                counts,
                slow,
                *self._noise,
                self._thresholds,
                self.config.readmit_s * 1e6,
            )
            results += self._said(decision, said, values, counts)
        return results, ReferenceState(detector, NO_SAMPLES, values, counts, slow, decision)

    def _said(
        self, decision: Decision, said: Vector, values: Vector, counts: Counts
    ) -> list[Result]:
        """What the kernel found, in the words of `analysis.results`."""
        found: list[Result] = []
        isolated = counts[:, ISOLATED].tolist()
        for sensor, (code, statistic, dof) in enumerate(said.tolist()):
            if code == NOTHING:
                continue
            if code != TESTED:
                reason = REASONS[code].format(fix_type=values[sensor, 6])
                found.append(_untested(sensor, decision, reason, isolated[sensor]))
                continue
            threshold = float(self._thresholds[int(dof)])
            found.append(
                SensorDecision(
                    t_s=decision.t_s,
                    t_us=decision.t_us,
                    sensor=SENSORS[sensor],
                    statistic=statistic if math.isfinite(statistic) else None,
                    threshold=threshold,
                    dof=int(dof),
                    alarm=not statistic <= threshold,
                    isolated=bool(isolated[sensor]),
                )
            )
        return found


def _with_newest(piece: Piece, stamps: Stamps, values: Vector) -> tuple[Stamps, Vector]:
    """The newest sample of each sensor after a piece."""
    stamps, values, block = stamps.copy(), values.copy(), piece.block
    for kind, row in piece.newest.items():
        number = NUMBER_OF[kind]
        stamps[number], values[number] = block.t_us[row], block.values[row]
    if piece.kind == kinds.FIX:
        for number in GPS:
            stamps[number], values[number] = piece.t_us, block.values[piece.last]
    return stamps, values


def _of_same_instant(decision: Decision | None, t_us: int) -> Decision | None:
    """The newest decision if a fix belongs to its epoch: a receiver sends it after the ranges."""
    if decision is None or abs(t_us - decision.t_us) * 1e-6 > FIX_OF_EPOCH_S:
        return None
    return decision


def _without_reference(decision: Decision, stamps: Stamps, counts: Counts) -> list[Result]:
    """Nothing can be said of the sensors that there are."""
    return [
        _untested(sensor, decision, "no sound reference", counts[sensor, ISOLATED])
        for sensor in np.flatnonzero(stamps != NEVER_US).tolist()
    ]


def _untested(sensor: int, decision: Decision, reason: str, isolated: int) -> SensorDecision:
    return SensorDecision(
        t_s=decision.t_s,
        t_us=decision.t_us,
        sensor=SENSORS[sensor],
        statistic=None,
        threshold=None,
        dof=0,
        alarm=False,
        isolated=bool(isolated),
        reason=reason,
    )
