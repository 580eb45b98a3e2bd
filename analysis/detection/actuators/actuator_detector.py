"""The actuator detector: isolates motors and surfaces that do not respond to their commands.

It reports every second while all actuators respond, and every half second while one does not.
"""

from typing import ClassVar

from analysis.detection.actuators.actuator_hypotheses import DETECTION_SCORE, LOAD, PITOT
from analysis.detection.actuators.actuator_response import (
    BY_FIRST_FIX,
    ELEVATOR,
    FLYING_SPEED_MPS,
    ActuatorResponse,
    ActuatorVerdict,
)
from analysis.detection.actuators.alarm_precedence import ACTUATORS
from analysis.detection.actuators.effects import AXES, Effects
from analysis.detection.actuators.motion_bins import MotionBins
from analysis.detection.actuators.motion_filter import initial_motion_model
from analysis.detection.detector_registry import BlockDetector, RowResults
from analysis.results import OR_SEPARATOR, SensorDecision
from analysis.samples.block import COMMAND, Block


class ActuatorDetector(BlockDetector, frozen=True):
    """Compares commands with the motion that `effects` predict; idle until the first command."""

    channels: ClassVar = frozenset({ACTUATORS})

    effects: Effects

    def step(
        self, block: Block, state: ActuatorResponse | None
    ) -> tuple[RowResults, ActuatorResponse | None]:
        """The results of the next samples by row, and the state, which is changed in place."""
        if state is None:
            if not (block.kind == COMMAND).any():
                return [], None
            state = initial_response(self.effects)
        names = dict(enumerate(self.effects.names)) | {LOAD: "load", PITOT: "airspeed"}
        return [
            (verdict.row, _result(verdict, [names[n] for n in verdict.isolated if n in names]))
            for verdict in state.add_block(block)
        ], state


def initial_response(effects: Effects) -> ActuatorResponse:
    """The state when the first command comes."""
    ground_mps = BY_FIRST_FIX if ELEVATOR in effects.names else FLYING_SPEED_MPS
    bins, model = MotionBins(effects.lags_s), initial_motion_model(effects)
    return ActuatorResponse(bins, model, effects.disturbance(), ground_mps)


def _result(verdict: ActuatorVerdict, isolated: list[str]) -> SensorDecision:
    name = OR_SEPARATOR.join(isolated)
    return SensorDecision(
        t_us=verdict.t_us,
        sensor=ACTUATORS,
        statistic=verdict.statistic,
        threshold=None if verdict.statistic is None else DETECTION_SCORE,
        dof=AXES,
        alarm=bool(isolated),
        isolated=len(isolated) == 1,
        reason=_reason(name, verdict),
        suspect=name,
    )


def _reason(name: str, verdict: ActuatorVerdict) -> str:
    deficit, loss = verdict.deficit, verdict.share
    if not name:
        return ""
    if verdict.statistic is None:
        return f"{name}: its output is switched off in flight"
    if loss > 0.0:
        return f"{name}: follows {max(0.0, 1.0 - loss):.2f} of its command"
    if deficit == 0.0:  # the hypothesis holds no longer, the alarm has not ended yet
        return name
    side = "below" if deficit > 0.0 else "above"
    return f"{name}: {abs(deficit):.2f} {side} its command"
