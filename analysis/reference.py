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
from dataclasses import dataclass, field, replace
from functools import cached_property

from analysis.block import Block, Piece, pieces
from analysis.fdi.config import DetectorConfig
from analysis.fdi.core import State
from analysis.fdi.detector import Detector
from analysis.fdi.thresholds import chi_square
from analysis.reference_kernel import test
from analysis.reference_models import MODELS, Seen, SensorNoise, Slow, View, view
from analysis.results import Decision, Result, SensorDecision
from analysis.samples import (
    AirspeedSample,
    BaroSample,
    GpsFix,
    MagSample,
    RangeSample,
    Sample,
    VisionSample,
)

FIX_OF_EPOCH_S = 0.01

KINDS: dict[type, tuple[str, ...]] = {
    MagSample: ("mag",),
    BaroSample: ("baro",),
    AirspeedSample: ("airspeed",),
    RangeSample: ("range",),
    VisionSample: ("vision",),
    GpsFix: ("gps-position", "gps-velocity"),
}
SENSORS = tuple(sensor for sensors in KINDS.values() for sensor in sensors)
SOUND = ("none", "satellites", "clock", "gps")
STALE_S = 0.5
FAILS_TO_ISOLATE = 3


@dataclass(frozen=True, slots=True)
class Watch:
    """One sensor: its slow states, how often it failed running, and whether it is isolated."""

    slow: Slow | None = None
    fails: int = 0
    isolated: bool = False
    healthy_since_us: int | None = None


@dataclass(frozen=True, slots=True)
class ReferenceState:
    """The detector's state, each sensor's newest sample and its watch, the newest decision."""

    detector: State
    newest: dict[str, Sample]
    watches: dict[str, Watch]
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

    def new_state(self) -> ReferenceState:
        """Nothing known."""
        return ReferenceState(self.detector.new_state(), {}, {})

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
        newest, event = state.newest, piece.event
        known = (
            [*piece.newest.values(), event] if isinstance(event, GpsFix) else piece.newest.values()
        )
        for sample in known:
            newest = newest | dict.fromkeys(KINDS[type(sample)], sample)
        results, detector = self.detector.take(piece, state.detector)
        decision = next((r for r in results if isinstance(r, Decision)), None)
        if decision is None and isinstance(event, GpsFix):
            decision = _of_same_instant(state.decision, event)
        if decision is None or decision.mode == "":
            return results, ReferenceState(detector, newest, state.watches, state.decision)
        watches = dict(state.watches)
        motion = detector.core.motion
        at = view(motion) if motion is not None and decision.hypothesis in SOUND else None
        for sensor in SENSORS:
            waiting = newest.get(sensor)
            if waiting is None:
                continue
            if sensor.startswith("gps") and decision.mode.startswith("position"):
                continue  # the fix is the filter's own input
            judged, watch = self._judge(sensor, waiting, decision, at, watches.get(sensor))
            watches[sensor] = watch
            results = [*results, *judged]
        return results, ReferenceState(detector, {}, watches, decision)

    def _judge(
        self,
        sensor: str,
        sample: Sample,
        decision: Decision,
        at: View | None,
        watch: Watch | None,
    ) -> tuple[list[Result], Watch]:
        """One sensor's test at one epoch, where the filter is sound."""
        watch = watch or Watch()
        if at is None:
            return [_untested(sensor, decision, "no sound reference", watch)], watch
        if abs(sample.t_us - decision.t_us) * 1e-6 > STALE_S:
            return [], watch
        seen = MODELS[sensor](sample, at, watch.slow, self.sensors)
        if isinstance(seen, str):
            return [_untested(sensor, decision, seen, watch)], watch
        if isinstance(seen, Slow):
            return [], replace(watch, slow=seen)
        return self._tested(sensor, seen, decision, watch)

    def _tested(
        self, sensor: str, seen: Seen, decision: Decision, watch: Watch
    ) -> tuple[list[Result], Watch]:
        slow = seen.slow
        dt_s = (decision.t_us - slow.t_us) * 1e-6
        q, b, p = test(seen.v, seen.h, seen.r, slow.b, slow.p, slow.walk, dt_s)
        threshold = chi_square(len(seen.v), self.config.p_other)
        failed = not q <= threshold
        watch = self._hysteresis(watch, failed, decision.t_us)
        if failed or watch.isolated:
            b, p = slow.b, slow.p  # the offset keeps still
        slow = Slow(decision.t_us, b, p, slow.walk)
        result = SensorDecision(
            t_s=decision.t_s,
            t_us=decision.t_us,
            sensor=sensor,
            statistic=q if math.isfinite(q) else None,
            threshold=threshold,
            dof=len(seen.v),
            alarm=failed,
            isolated=watch.isolated,
        )
        return [result], replace(watch, slow=slow)

    def _hysteresis(self, watch: Watch, failed: bool, t_us: int) -> Watch:
        if failed:
            fails = watch.fails + 1
            return Watch(watch.slow, fails, watch.isolated or fails >= FAILS_TO_ISOLATE)
        if not watch.isolated:
            return Watch(watch.slow)
        since = watch.healthy_since_us if watch.healthy_since_us is not None else t_us
        if (t_us - since) * 1e-6 >= self.config.readmit_s:
            return Watch(watch.slow)
        return Watch(watch.slow, 0, True, since)


def _of_same_instant(decision: Decision | None, fix: GpsFix) -> Decision | None:
    """The newest decision if a fix belongs to its epoch: a receiver sends it after the ranges."""
    if decision is None or abs(fix.t_us - decision.t_us) * 1e-6 > FIX_OF_EPOCH_S:
        return None
    return decision


def _untested(sensor: str, decision: Decision, reason: str, watch: Watch) -> SensorDecision:
    return SensorDecision(
        t_s=decision.t_s,
        t_us=decision.t_us,
        sensor=sensor,
        statistic=None,
        threshold=None,
        dof=0,
        alarm=False,
        isolated=watch.isolated,
        reason=reason,
    )
