"""Tracks the response of actuators through the samples of a block.

The test is suspended on the ground and where a leg may touch it (docs/watches.md, "Actuators"). The
vehicle counts as flying once it is 3 m above its first fix or faster than 3 m/s, until it rests
near its first height again. An impact while an actuator is isolated is a crash.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from analysis.detection.actuators.actuator_hypotheses import (
    LOAD,
    NO_HYPOTHESIS,
    OUTLIER_STATISTIC,
    PITCH,
    ActuatorHypothesis,
    find_hypothesis,
)
from analysis.detection.actuators.alarm_precedence import IMPACT_MPS2
from analysis.detection.actuators.effects import COMMANDS, FORCE, OUTPUT, RATE, Effects
from analysis.detection.actuators.motion_bins import AIR_LASTS_US, MotionBins
from analysis.detection.actuators.motion_filter import MotionModel
from analysis.detection.actuators.motor_imbalance import MOTOR_COUNT, MotorTrim
from analysis.detection.actuators.response_regression import (
    BINS_PER_STEP,
    NO_HYPOTHESES,
    ResponseRegression,
)
from analysis.detection.actuators.switched_off import OutputStates
from analysis.results import FOREVER_US
from analysis.samples.block import (
    AIRSPEED,
    COMMAND,
    COMMAND_SOURCE,
    CONTROLS,
    FIX,
    FIX_3D,
    FIX_TYPE,
    IMU,
    IMU_ID,
    OUTPUTS,
    Block,
)
from analysis.samples.sample import IMU_VALUE_LIMIT, Vector
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3

LEARNED_BINS = 30  # 3 s of flight before the first test: a constant is known to a fifth of a bin
# Of a learned effect: thrust grows with the square of the command, which moves by 2 % in hover.
NONLINEAR_SHARE = 0.02
MOST_OUTLIER_BINS = 30  # 3 s; a longer run of outliers is changed noise or no actuator's fault
NOMINAL_BINS = 10  # without a hypothesis until learning resumes: 1 s
# Bins in a row that confirm one hypothesis, or two that are not separable: most pairs separate in
# 1.2 s (benchmarks/actuator_watch.py: 0.3 s of the delays).
SINGLE_BINS, PAIR_BINS = 3, 12
# A smaller deficit may be a gust; no gust lasts 0.8 s (benchmarks/actuator_watch.py).
SLIGHT_DEFICIT, SLIGHT_BINS = 0.15, 8
REPEAT_ISOLATED_BINS, REPEAT_NOMINAL_BINS = 5, 10  # bins between two results
# Ten sigma of a receiver's velocity (0.3 m/s) and two of its height (1.5 m); at rest, 1.7 sigma.
FLYING_HEIGHT_M, FLYING_SPEED_MPS, REST_SPEED_MPS = 3.0, 3.0, 0.5
ELEVATOR = "elevator"  # only vehicles with wings have one
BY_FIRST_FIX = -1.0  # the first fix decides
ALT, VELOCITY = 2, slice(3, 6)  # columns of a fix
GAP_US = 500_000  # without an IMU sample the motion begins anew
IRREGULAR_BINS = 10  # 1 s without a test after frames that a link swapped, or near the ground
INTERVAL_SHARE = 0.02  # weight of a command in the usual interval: 50 commands
SPARSE_COMMAND_US = 60_000  # longer intervals hide what motors (lag 40 ms) do in between
IMPACT_BINS = 50  # 5 s: until what has hit the ground lies still; ArduPilot's crash check waits 2 s
# r above which learning pauses (3.5 sigma), and for how many bins at most; else a stuck rudder
# is missed (benchmarks/actuator_watch.py).
DOUBT_STATISTIC, MOST_DOUBTFUL_BINS = 12.0, 200


class ActuatorVerdict(NamedTuple):
    """Up to two isolated actuators; of an output that is switched off the statistic is None. The
    lost `share` of the command replaces the deficit."""

    row: int
    t_us: int
    isolated: tuple[int, int]
    statistic: float | None = None
    deficit: float = 0.0
    share: float = 0.0


@dataclass(slots=True)
class ActuatorResponse:
    """The state of all actuators.

    `ground_mps` is the speed below which the vehicle may be on the ground near the height of its
    first fix (or `BY_FIRST_FIX`).
    """

    bins: MotionBins
    model: MotionModel
    disturbance: Vector  # covariance (AXES, AXES) of gusts and model error
    ground_mps: float
    outputs: OutputStates = field(default_factory=OutputStates)
    trim: MotorTrim = field(default_factory=MotorTrim)
    regression: ResponseRegression = field(default_factory=ResponseRegression)
    first_alt_m: float = math.nan
    source: int = 0  # of the commands
    interval_us: float = math.nan  # of the commands
    command_us: int = -FOREVER_US
    from_ground: bool = False  # its motors stood still at the first command
    flies: bool = False
    crash_us: int = FOREVER_US
    irregular_left: int = 0  # bins left to skip
    outlier_run: int = 0  # bins in a row: of outliers, without and with this hypothesis, doubtful
    nominal_run: int = 0
    hypothesis_run: int = 0
    doubtful_run: int = 0
    since_result: int = 0
    hypothesis: tuple[int, int] = NO_HYPOTHESES
    isolated: tuple[int, int] = NO_HYPOTHESES

    @property
    def effects(self) -> Effects:
        """What the outputs do, as known before the flight."""
        return self.model.effects

    def add_block(self, block: Block) -> Iterator[ActuatorVerdict]:
        """The verdicts on the samples of a block, in order."""
        # Only the first IMU is used; the comparison is false for NaN.
        of_imu = (block.kind == IMU) & (block.values[:, IMU_ID] == 0.0)
        of_imu &= (np.abs(block.values[:, :IMU_ID]) <= IMU_VALUE_LIMIT).all(axis=1)
        rows = np.flatnonzero(of_imu | np.isin(block.kind, (COMMAND, FIX, AIRSPEED)))
        columns = rows.tolist(), block.kind[rows].tolist(), block.t_us[rows].tolist()
        for row, kind, t_us in zip(*columns, strict=True):
            values, verdict = block.values[row], None
            if kind == COMMAND:
                verdict = self._take_command(row, t_us, values)
            # Ignored before the first command, or results would depend on how the stream is cut.
            elif not self.source:
                continue
            elif kind == FIX:
                self._update_flying(values)
            elif kind == AIRSPEED and 0.0 < values[0] < math.inf:
                self.bins.air_mps = math.sqrt(2.0 * values[0] / SEA_LEVEL_DENSITY_KGPM3)
                self.bins.air_until_us = t_us + AIR_LASTS_US
            elif kind == IMU and self.flies:
                verdict = self._add_imu_sample(row, t_us, values[:IMU_ID])
            if verdict is not None:
                yield verdict

    def _add_imu_sample(self, row: int, t_us: int, values: Vector) -> ActuatorVerdict | None:
        # A link that swaps frames mixes commands and motion of different times.
        late_us = self.bins.sample_us - t_us
        if 0 < late_us < GAP_US:
            self.irregular_left = IRREGULAR_BINS
            return None
        if abs(late_us) > GAP_US:
            self._begin_flight()
        impact = math.hypot(*values[3:6].tolist()) > IMPACT_MPS2
        if impact and self.isolated == NO_HYPOTHESES:
            # What moves the vehicle is then what it has hit, not its actuators.
            self.irregular_left = IMPACT_BINS
        elif impact and self.crash_us == FOREVER_US:
            self.crash_us = t_us
        full = self.bins.add_imu_sample(t_us, values)
        if full is None:
            return None
        if self.irregular_left > 0:
            self.irregular_left -= 1
            return None
        found = self._test_bin(*full)
        if not self._is_observable() or not self._update_isolation(found):
            return None
        return ActuatorVerdict(
            row, t_us, self.isolated, found.statistic, found.deficit, found.share
        )

    def _take_command(self, row: int, t_us: int, values: Vector) -> ActuatorVerdict | None:
        """Use commands of the first source, or of the one that the effects are for."""
        source, outputs = int(values[COMMAND_SOURCE]), values[:COMMANDS]
        if not self.source and (source == CONTROLS or self.effects.unknown):
            self.source = source
            wings = ELEVATOR in self.effects.names  # theirs is decided by the first fix
            self.from_ground = source == CONTROLS and not wings and not outputs.any()
        if source != self.source or not (np.abs(outputs) <= IMU_VALUE_LIMIT).all():
            return None
        apart_us, self.command_us = t_us - self.command_us, t_us
        if 0 < apart_us < GAP_US:
            if math.isnan(self.interval_us):
                self.interval_us = apart_us
            self.interval_us += INTERVAL_SHARE * (apart_us - self.interval_us)
        self.bins.commands = self.effects.mix @ outputs
        if source != OUTPUTS:
            return None
        off = self.outputs.track_outputs(outputs, t_us, self.flies)
        if off is not None:
            return ActuatorVerdict(row, t_us, (NO_HYPOTHESIS, off))
        return self._test_imbalance(row, t_us, outputs) if self.effects.unknown else None

    def _test_imbalance(self, row: int, t_us: int, outputs: Vector) -> ActuatorVerdict | None:
        """Compare sparse outputs with each other, as they cannot be compared with the motion."""
        if not self.flies:
            self.trim.reset()
            return None
        if not self.interval_us >= SPARSE_COMMAND_US or self._is_off() or self.irregular_left > 0:
            return None
        who = self.trim.track_imbalance(outputs, self.interval_us * 1e-6, self.outputs)
        if who is None:
            return None
        pair = NO_HYPOTHESIS, who
        return ActuatorVerdict(row, t_us, pair, self.trim.score, self.trim.raised)

    def _begin_flight(self) -> None:
        """Reset the parts of the state that a take-off or a gap invalidates."""
        self.bins.has_previous = False
        self.model.reset()
        self.regression.reset()

    def _update_flying(self, fix: Vector) -> None:
        """Detect take-off and landing from a receiver's fix."""
        if fix[FIX_TYPE] < FIX_3D:
            return
        speed = math.sqrt(np.nansum(fix[VELOCITY] ** 2))
        if math.isnan(self.first_alt_m):
            self.first_alt_m = float(fix[ALT])
            if self.ground_mps == BY_FIRST_FIX:
                self.ground_mps = math.inf if speed < REST_SPEED_MPS else FLYING_SPEED_MPS
        up = bool(abs(fix[ALT] - self.first_alt_m) > FLYING_HEIGHT_M)
        if up and self.from_ground:
            self.ground_mps = math.inf
        if not self.flies and (up or speed > FLYING_SPEED_MPS):
            self.flies, self.crash_us = True, FOREVER_US
            self._begin_flight()
        elif self.flies and not up and speed < REST_SPEED_MPS:
            self.flies, self.isolated = False, NO_HYPOTHESES
        elif not up and speed < self.ground_mps:
            self.irregular_left = IRREGULAR_BINS

    def _is_off(self) -> bool:
        """Whether an output is switched off: the vehicle is then another."""
        return bool(self.outputs.reported.any() or self.outputs.parked.any())

    def _is_observable(self) -> bool:
        """Whether the actuators' effects are known."""
        if self._is_off():
            return False
        if not self.effects.unknown:
            return True
        dense = self.interval_us < SPARSE_COMMAND_US
        return dense and int(self.model.known_rotors().sum()) == MOTOR_COUNT

    def _test_bin(self, terms: Vector, motion: Vector) -> ActuatorHypothesis:
        """Compare a full bin with the model, find a hypothesis, and learn if there is none."""
        model = self.model
        model.compare_motion(terms, motion)
        covariance = model.spread + self.disturbance + model.covariance()
        if self.effects.unknown:
            strongest = np.abs(model.theta[:, OUTPUT:RATE]).max(axis=1)
            covariance += np.diag((NONLINEAR_SHARE * strongest) ** 2)
        found = find_hypothesis(covariance, model)
        learned = model.bins > LEARNED_BINS and self._is_observable()
        statistic = found.statistic
        self.outlier_run = self.outlier_run + 1 if statistic >= OUTLIER_STATISTIC else 0
        if learned:
            self._update_response(terms)
            found = self._with_regression(found)
        else:
            found = ActuatorHypothesis(statistic)
        self.nominal_run = self.nominal_run + 1 if found.first == NO_HYPOTHESIS else 0
        model.learn_motion(terms, motion, statistic, learned and self._suspends_learning())
        return found

    def _suspends_learning(self) -> bool:
        """Whether the model must not learn now because an actuator may be faulty."""
        if self.regression.hypotheses[0] == LOAD:
            return False
        suspected = self.nominal_run < NOMINAL_BINS or self.isolated != NO_HYPOTHESES
        unusual = 0 < self.outlier_run < MOST_OUTLIER_BINS
        return suspected or unusual or 0 < self.doubtful_run < MOST_DOUBTFUL_BINS

    def _update_response(self, terms: Vector) -> None:
        """Update the regression over seconds."""
        regression = self.regression
        known = regression.hypotheses[0]
        if self.outlier_run == 1 and not 0 <= known < COMMANDS:  # a fault may have begun
            regression.reset()
        doubtful = regression.explained.max() > DOUBT_STATISTIC
        self.doubtful_run = self.doubtful_run + 1 if doubtful else 0
        regression.update(terms, self.model, self._suspends_learning())
        if regression.hypotheses[0] == LOAD and known != LOAD:
            # The shifted load is a new moment, which the model has to learn.
            self.model.p[PITCH, FORCE + 1, FORCE + 1] += regression.shares[LOAD] ** 2

    def _with_regression(self, found: ActuatorHypothesis) -> ActuatorHypothesis:
        """The hypothesis, replaced by the regression's where that is more specific."""
        regression = self.regression
        first, second = regression.hypotheses
        slight = found.first == NO_HYPOTHESIS or LOAD in (found.first, found.second)
        if first >= COMMANDS and slight:
            return ActuatorHypothesis(0.0)
        if NO_HYPOTHESIS < first < COMMANDS and (slight or found.second != NO_HYPOTHESIS):
            explained = max(found.statistic, float(regression.explained[first]))
            share = float(regression.shares[first])
            return ActuatorHypothesis(explained, first, second, share=share)
        return found

    def _update_isolation(self, found: ActuatorHypothesis) -> bool:
        """Update the isolated actuators; whether a result is due."""
        # A single hypothesis is second: NO_HYPOTHESIS is the smallest.
        pair = min(found.first, found.second), max(found.first, found.second)
        self.hypothesis_run = self.hypothesis_run + 1 if pair == self.hypothesis else 1
        self.hypothesis = pair
        self.since_result += 1
        # The fault changes the flight, so the first isolation is the most reliable and is kept.
        most = SINGLE_BINS if pair[0] == NO_HYPOTHESIS else PAIR_BINS
        if found.share > 0.0:
            most = max(most, BINS_PER_STEP + 1)  # a second step of the regression agrees
        elif abs(found.deficit) < SLIGHT_DEFICIT:
            most = max(most, SLIGHT_BINS)
        confirmed = found.first != NO_HYPOTHESIS and self.hypothesis_run >= most
        narrows = (
            pair[0] == NO_HYPOTHESIS
            and self.isolated[0] != NO_HYPOTHESIS
            and pair[1] in self.isolated
        )
        if confirmed and (self.isolated == NO_HYPOTHESES or narrows):
            self.isolated, self.since_result = pair, REPEAT_ISOLATED_BINS
        elif self.isolated != NO_HYPOTHESES and found.statistic < OUTLIER_STATISTIC:
            self.isolated, self.since_result = NO_HYPOTHESES, REPEAT_NOMINAL_BINS
            # The end of a fault moves residual and command alike, which looks like a total loss.
            self.regression.reset()
        pause = REPEAT_NOMINAL_BINS if self.isolated == NO_HYPOTHESES else REPEAT_ISOLATED_BINS
        if self.since_result < pause:
            return False
        self.since_result = 0
        return True
