"""The actuator detector: isolates motors and surfaces that do not respond to their commands.

It reports every second while all actuators respond, and every half second while one does not.
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

ELEVATOR = "elevator"  # only vehicles with wings have one


class ActuatorDetector(BlockDetector, frozen=True):
    """Compares commands with the motion that `effects` predict; idle until the first command."""

    channels: ClassVar = frozenset({ACTUATORS})

    effects: Effects

    def step(
        self, block: Block, state: ActuatorResponse | None
    ) -> tuple[list[tuple[int, SensorDecision]], ActuatorResponse | None]:
        """The results of the next samples by row, and the state, which is changed in place."""
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
        rows = zip(verdicts.rows[:filled].tolist(), verdicts.values[:filled].tolist(), strict=True)
        names = dict(enumerate(self.effects.names)) | {LOAD: "load", PITOT: "airspeed"}
        return [
            (row, _result(t_us, [names[n] for n in numbers if n != NO_HYPOTHESIS], *values))
            for (row, t_us, *numbers), values in rows
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
    t_us: int, isolated: list[str], statistic: float, deficit: float, loss: float
) -> SensorDecision:
    name = OR_SEPARATOR.join(isolated)
    return SensorDecision(
        t_us=t_us,
        sensor=ACTUATORS,
        statistic=None if statistic == NO_STATISTIC else statistic,
        threshold=None if statistic == NO_STATISTIC else DETECTION_SCORE,
        dof=AXES,
        alarm=bool(isolated),
        isolated=len(isolated) == 1,
        reason=_reason(name, deficit, loss),
        suspect=name,
    )


def _reason(name: str, deficit: float, loss: float) -> str:
    if not name:
        return ""
    if deficit == NO_STATISTIC:
        return f"{name}: its output is switched off in flight"
    if loss > 0.0:
        return f"{name}: follows {max(0.0, 1.0 - loss):.2f} of its command"
    if deficit == 0.0:  # the hypothesis holds no longer, the alarm has not ended yet
        return name
    side = "below" if deficit > 0.0 else "above"
    return f"{name}: {abs(deficit):.2f} {side} its command"
