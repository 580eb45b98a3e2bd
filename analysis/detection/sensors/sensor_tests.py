"""Tests the other sensors with the navigation filter: barometer, airspeed, magnetometer, vision,
range, and a receiver's own position and velocity.

While the detector finds its reference healthy, every sensor's newest sample is tested at each GNSS
epoch (docs/fdi.md, "Other sensors"; predictions in `sensor_models`). The slow states of an isolated
sensor are frozen; one whose offset is again that of its first ten seconds has returned from a
drift, and is healthy at once.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.detector import Detector, EventDetector
from analysis.detection.detector_state import DetectorState
from analysis.detection.filter.filter_state import MotionEstimate
from analysis.detection.sensors.sensor_models import (
    MODELS,
    FilterView,
    SlowStates,
    view_filter,
)
from analysis.detection.statistics.chi_square import chi_square_threshold
from analysis.results import Decision, Result, SensorDecision
from analysis.samples.block import (
    AIRSPEED,
    BARO,
    FIX,
    KINDS,
    MAG,
    NEVER_US,
    RANGE,
    VISION,
    BlockSlice,
)
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.linear import invert_positive_definite

FAILS_TO_ISOLATE = 3  # failures in a row: one outlier isolates no sensor, p_other^3 is 1e-15
SIZE_SIGMAS = 4.0  # error of the field's size above which the magnetometer is at fault: p 6e-5
WITH_OFFSET = ("baro", "vision")  # slow states of the others are the wind, the field, the terrain
SETTLED_S = 10.0  # the slow states are then known to a seventh of the noise, of 50 epochs at 5 Hz
STALE_S = 0.5  # older samples are not tested: two of a sensor at 5 Hz are missing
SAME_US = 10_000  # a fix this close to an epoch belongs to it: receivers send it after the ranges
NOISE_MEMORY_S = 30.0  # of a sensor's noise: of 150 epochs at 5 Hz, known to a tenth
# hypotheses under which the filter is healthy
SOUND_FILTER = ("none", "satellites", "clock", "gps")
OF_RECEIVER = ("gps-position", "gps-velocity")
SENSORS_OF = {
    MAG: ("mag",),
    BARO: ("baro",),
    AIRSPEED: ("airspeed",),
    RANGE: ("range",),
    VISION: ("vision",),
    FIX: OF_RECEIVER,
}


@dataclass(slots=True)
class SensorState:
    """The newest sample since the newest decision, and what is known of the sensor."""

    variance: float  # of its innovations
    stamp_us: int = NEVER_US  # NEVER_US: there is no sample
    z: Vector = field(default_factory=lambda: np.empty(0))
    slow: SlowStates | None = None
    slow_us: int = NEVER_US
    begun_us: int = NEVER_US  # when they were started
    settled: SlowStates | None = None  # these SETTLED_S later
    fails: int = 0
    isolated: bool = False
    healthy_us: int = NEVER_US

    def count_failure(self, failed: bool, own: bool, t_us: int, readmit_us: float) -> None:
        """Isolate after some failures of the sensor's own in a row, readmit after health."""
        since_us, self.healthy_us = self.healthy_us, NEVER_US
        if failed:
            self.fails += 1
            self.isolated |= own and self.fails >= FAILS_TO_ISOLATE
            return
        self.fails = 0
        if self.isolated:
            self.healthy_us = t_us if since_us == NEVER_US else since_us
            if t_us - self.healthy_us >= readmit_us:
                self.isolated, self.healthy_us = False, NEVER_US


@dataclass(slots=True)
class SensorStates:
    """The sensors by name, the newest decided epoch, and the largest rate of turn since."""

    sensors: dict[str, SensorState]
    epoch_us: int = NEVER_US
    view: FilterView | None = None  # of the filter then, if it is a reference
    by_fix: bool = False
    turning_rps: float = 0.0

    def add_samples(self, piece: BlockSlice) -> None:
        """Add the newest sample of each sensor, and the rates of turn (NaN of lost samples)."""
        block, last = piece.block, piece.last
        rows = piece.first + np.flatnonzero(_OF_SENSORS[block.kind[piece.first : last + 1]])
        for row in rows.tolist():
            for name in SENSORS_OF[int(block.kind[row])]:
                state = self.sensors[name]
                state.stamp_us, state.z = int(block.t_us[row]), block.values[row].copy()
        rates_rps = np.linalg.norm(piece.imu.values[:, :3], axis=1)
        self.turning_rps = float(np.fmax.reduce(rates_rps, initial=self.turning_rps))

    def copy(self) -> "SensorStates":
        """A copy, to be changed."""
        return replace(self, sensors={name: replace(one) for name, one in self.sensors.items()})


@dataclass(frozen=True, slots=True)
class NavigationState:
    """The state of the detector and of the other sensors."""

    detector: DetectorState
    states: SensorStates


@dataclass(frozen=True)
class NavigationDetector(EventDetector[NavigationState]):
    """The detector, and the tests of the other sensors with its filter."""

    config: DetectorConfig = field(default_factory=DetectorConfig)

    @cached_property
    def detector(self) -> Detector:
        """The detector whose filter is the reference."""
        return Detector(self.config)

    def new_state(self) -> NavigationState:
        """No sample has come yet."""
        sensors = {name: SensorState(model.sigma**2) for name, model in MODELS.items()}
        return NavigationState(self.detector.new_state(), SensorStates(sensors))

    def step_piece(
        self, piece: BlockSlice, state: NavigationState
    ) -> tuple[list[Result], NavigationState]:
        """The results of samples up to an event: the detector's first, then the sensors'."""
        results, detector = self.detector.step_piece(piece, state.detector)
        decision = next((result for result in results if isinstance(result, Decision)), None)
        tested, states = self._tested(piece, decision, detector.core.motion, state.states)
        return [*results, *tested], NavigationState(detector, states)

    def _tested(
        self,
        piece: BlockSlice,
        decision: Decision | None,
        motion: MotionEstimate | None,
        states: SensorStates,
    ) -> tuple[list[SensorDecision], SensorStates]:
        """The sensors' tests at the end of a piece, with the decision and the filter there."""
        # A copy is changed in place; the given state is not.
        states = states.copy()
        states.add_samples(piece)
        names = _tested_sensors(piece, decision, states)
        if decision is not None and names:
            # Also without a sample: a late fix is compared with it.
            states.view = _view_reference(decision, motion, states.turning_rps)
            names = tuple(n for n in names if states.sensors[n].stamp_us != NEVER_US)
            states.turning_rps = 0.0 if names else states.turning_rps
        return self._outcomes(names, states), states

    def _outcomes(self, names: Sequence[str], states: SensorStates) -> list[SensorDecision]:
        """The tests of some sensors by the newest decision; each sample is tested once."""
        found, view = [], states.view
        for name in names:
            state = states.sensors[name]
            stamp_us, state.stamp_us = state.stamp_us, NEVER_US
            late_us = abs(states.epoch_us - stamp_us)
            if stamp_us == NEVER_US or (view and late_us > STALE_S * 1e6):
                continue
            if view is None:
                t_us = max(states.epoch_us, stamp_us)
                found.append(_untested(t_us, name, state, "no healthy reference"))
            elif result := self._test(name, state, view, states.epoch_us, stamp_us):
                found.append(result)
        return found

    def _test(
        self, name: str, state: SensorState, view: FilterView, epoch_us: int, stamp_us: int
    ) -> SensorDecision | None:
        """One sensor's test; None if it only started its slow states."""
        model = MODELS[name]
        sigma = min(model.sigma, max(model.least_sigma, math.sqrt(state.variance)))
        slow, late_s = state.slow, (epoch_us - stamp_us) * 1e-6
        # A fix comes later than its stamp; a result is not older than its sample.
        t_us = max(epoch_us, stamp_us)
        known = None if slow is None else slow.b
        outcome = model.innovation(state.z, view, known, late_s, sigma)
        if isinstance(outcome, str):
            return _untested(t_us, name, state, outcome)
        elapsed_s = max((epoch_us - state.slow_us) * 1e-6, 0.0)
        state.slow_us = epoch_us
        if slow is None or isinstance(outcome, SlowStates):
            assert isinstance(outcome, SlowStates)
            state.slow, state.begun_us = outcome, epoch_us
            return None
        tested = _test_innovation(outcome, slow, model.walk**2 * elapsed_s)
        threshold = chi_square_threshold(len(outcome.v), self.config.p_other)
        if not tested.statistic <= threshold and state.settled is not None:
            outcome = model.innovation(state.z, view, state.settled.b, late_s, sigma)
            assert not isinstance(outcome, str | SlowStates)
            # Not wider with time, or a fault could hide in what may have changed since.
            returned = _test_innovation(outcome, state.settled, model.walk**2 * elapsed_s)
            if returned.statistic <= threshold:
                tested, slow, state.isolated = returned, state.settled, False
        statistic, failed = tested.statistic, not tested.statistic <= threshold
        # A field of the right size in the wrong direction may be due to the attitude, which is the
        # IMU's fault. Written so that NaN is the sensor's own.
        resized = abs(math.hypot(*state.z[:3]) - math.hypot(*slow.b))
        own = name != "mag" or not resized <= SIZE_SIGMAS * sigma
        state.count_failure(failed, own, epoch_us, self.config.readmit_s * 1e6)
        if not failed and not state.isolated:  # else the slow states are frozen
            gain, v = tested.ph @ tested.inverse, tested.v
            state.slow = SlowStates(slow.b + gain @ v, tested.p - gain @ tested.ph.T)
            settled = epoch_us - state.begun_us >= SETTLED_S * 1e6
            if settled and state.settled is None and name in WITH_OFFSET:
                state.settled = state.slow
            share = min(elapsed_s / NOISE_MEMORY_S, 1.0) / len(v)
            for one in v.tolist():
                state.variance += share * (one**2 - state.variance)
        return SensorDecision(
            t_us=t_us,
            sensor=name,
            statistic=statistic if math.isfinite(statistic) else None,
            threshold=threshold,
            dof=len(tested.v),
            alarm=failed,
            isolated=state.isolated,
        )


class InnovationTest(NamedTuple):
    """Innovation v (m,), its statistic and inverse covariance (m, m); covariance p (n, n) of the
    slow states, and p h' (n, m)."""

    v: Vector
    statistic: float
    inverse: Vector
    p: Vector
    ph: Vector


def _test_innovation(
    outcome: tuple[Vector, Vector, Vector], slow: SlowStates, walked: float
) -> InnovationTest:
    """Test a sensor's innovation with slow states whose variance has grown by `walked`."""
    v, r, h = outcome
    p = slow.p + walked * np.eye(len(slow.b))
    ph = p @ h.T
    inverse = invert_positive_definite(h @ ph + r)
    return InnovationTest(v, float(v @ inverse @ v), inverse, p, ph)


_OF_SENSORS = np.isin(np.arange(len(KINDS)), list(SENSORS_OF))  # by kind of sample


def _tested_sensors(
    piece: BlockSlice, decision: Decision | None, states: SensorStates
) -> Sequence[str]:
    """The sensors whose samples are tested at the end of a piece, by the newest decision."""
    names: Sequence[str] = ()
    if decision is not None and decision.mode:  # an untestable epoch has no prediction
        states.epoch_us, states.by_fix = decision.t_us, decision.mode.startswith("position")
        names = tuple(states.sensors)
    elif decision is None and piece.kind == FIX and abs(piece.t_us - states.epoch_us) <= SAME_US:
        # A late fix comes when other sensors' newest samples belong to the next epoch.
        names = OF_RECEIVER
    if names and states.by_fix:  # the fix is the filter's input
        for name in OF_RECEIVER:
            states.sensors[name].stamp_us = NEVER_US
    return names


def _view_reference(
    decision: Decision, motion: MotionEstimate | None, turning_rps: float
) -> FilterView | None:
    """The filter as the models see it, if it is healthy."""
    bounded = decision.position_sigma_m is not None
    if motion is None or decision.hypothesis not in SOUND_FILTER or not bounded:
        return None
    return view_filter(motion, turning_rps)


def _untested(t_us: int, name: str, state: SensorState, reason: str) -> SensorDecision:
    return SensorDecision(t_us=t_us, sensor=name, isolated=state.isolated, reason=reason)
