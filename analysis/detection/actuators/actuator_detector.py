"""Actuators that do not obey: a step of the pipeline beside the detector.

The vehicle's effects are known; commands come with the samples. Every second of flight tells that
the actuators obey, and every half second who does not.
"""

from typing import ClassVar

import numpy as np

from analysis.detection.actuators.actuator_hypotheses import (
    DETECTION_SCORE,
    LOAD,
    NO_HYPOTHESIS,
    PITOT,
)
from analysis.detection.actuators.actuator_response import (
    BY_FIRST_FIX,
    COUNTS,
    CRASH_US,
    FLYING_SPEED_MPS,
    HYPOTHESIS,
    NEVER_US,
    NO_STATISTIC,
    ActuatorResponse,
    ActuatorVerdicts,
    track_actuators,
)
from analysis.detection.actuators.alarm_precedence import ACTUATORS
from analysis.detection.actuators.effects import AXES, Effects
from analysis.detection.actuators.motion_bins import new_motion_bins
from analysis.detection.actuators.motion_filter import initial_motion_model
from analysis.detection.actuators.motor_imbalance import new_motor_trim
from analysis.detection.actuators.response_regression import new_regression
from analysis.detection.actuators.switched_off import new_output_states
from analysis.detection.detector_registry import BlockDetector
from analysis.results import OR_SEPARATOR, SensorDecision
from analysis.samples.block import COMMAND, Block

ELEVATOR = "elevator"  # of those with wings


class ActuatorDetector(BlockDetector, frozen=True):
    """A step of the pipeline; without commands it does nothing."""

    channels: ClassVar = frozenset({ACTUATORS})

    effects: Effects

    def new_state(self) -> ActuatorResponse | None:
        """No command came yet."""
        return None

    def step(
        self, block: Block, state: ActuatorResponse | None
    ) -> tuple[list[tuple[int, SensorDecision]], ActuatorResponse | None]:
        """Whether the actuators obey, by the row that shows it, and the next state.

        The state is changed in place.
        """
        if state is None:
            if not (block.kind == COMMAND).any():
                return [], None
            state = _initial_state(self.effects)
        count = len(block.kind)
        verdicts = ActuatorVerdicts(
            np.empty((count, 4), np.int64), np.empty((count, 3)), np.zeros(1, np.int64)
        )
        track_actuators(block.kind, block.t_us, block.values, state, verdicts)
        filled = int(verdicts.filled[0])
        rows = zip(verdicts.rows[:filled].tolist(), verdicts.figures[:filled].tolist(), strict=True)
        names = dict(enumerate(self.effects.names)) | {LOAD: "load", PITOT: "airspeed"}
        return [
            (row, _result(t_us, [names[n] for n in numbers if n != NO_HYPOTHESIS], *figures))
            for (row, t_us, *numbers), figures in rows
        ], state


def _initial_state(effects: Effects) -> ActuatorResponse:
    """The state when the first command comes."""
    counts = np.zeros(COUNTS, np.int64)
    counts[HYPOTHESIS:CRASH_US] = NO_HYPOTHESIS
    counts[CRASH_US] = NEVER_US
    return ActuatorResponse(
        new_motion_bins(effects.lags_s),
        initial_motion_model(effects),
        new_output_states(),
        effects.mix,
        effects.disturbance(),
        counts,
        np.array([np.nan, BY_FIRST_FIX if ELEVATOR in effects.names else FLYING_SPEED_MPS]),
        np.full(3, np.nan),
        new_motor_trim(),
        new_regression(),
    )


def _result(
    t_us: int, blamed: list[str], statistic: float, deficit: float, lost: float
) -> SensorDecision:
    name = OR_SEPARATOR.join(blamed)
    return SensorDecision(
        t_us=t_us,
        sensor=ACTUATORS,
        statistic=None if statistic == NO_STATISTIC else statistic,
        threshold=None if statistic == NO_STATISTIC else DETECTION_SCORE,
        dof=AXES,
        alarm=bool(blamed),
        isolated=len(blamed) == 1,
        reason=_reason(name, deficit, lost),
        suspect=name,
    )


def _reason(name: str, deficit: float, lost: float) -> str:
    if not name:
        return ""
    if deficit == NO_STATISTIC:
        return f"{name}: its output is switched off in flight"
    if lost > 0.0:
        return f"{name}: follows {max(0.0, 1.0 - lost):.2f} of its command"
    if deficit == 0.0:  # nobody is suspected now, but was
        return name
    side = "below" if deficit > 0.0 else "above"
    return f"{name}: {abs(deficit):.2f} {side} its command"
