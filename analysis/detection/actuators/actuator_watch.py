"""Actuators that do not obey: a step of the pipeline beside the detector.

The vehicle's effects are known; commands come with the samples. Every second of flight tells that
the actuators obey, and every half second who does not.
"""

from dataclasses import dataclass

import numpy as np

from analysis.detection.actuators.effects import AXES, Effects
from analysis.detection.actuators.following import nothing_followed
from analysis.detection.actuators.motion_cells import no_cells
from analysis.detection.actuators.motion_filter import nothing_learnt
from analysis.detection.actuators.mutual_judgement import ACTUATORS
from analysis.detection.actuators.obedience_kernel import (
    BY_ITS_START,
    COUNTS,
    CRASH_US,
    FLIES_MPS,
    NEVER_US,
    OFF,
    SUSPECT,
    Obedience,
    Verdicts,
    follow,
)
from analysis.detection.actuators.suspects import LOAD, NOBODY, PITOT, SURE
from analysis.detection.actuators.switched_off import no_outputs
from analysis.detection.actuators.uneven import no_trim
from analysis.results import EITHER, SensorDecision
from analysis.samples.block import COMMAND, Block

ELEVATOR = "elevator"  # of those with wings


@dataclass(frozen=True)
class ActuatorWatch:
    """A step of the pipeline; without commands it does nothing."""

    effects: Effects

    def new_state(self) -> Obedience | None:
        """No command came yet."""
        return None

    def step(
        self, block: Block, state: Obedience | None
    ) -> tuple[list[tuple[int, SensorDecision]], Obedience | None]:
        """Whether the actuators obey, by the row that shows it, and the next state.

        The state is changed in place.
        """
        if state is None:
            if not (block.kind == COMMAND).any():
                return [], None
            state = _commanded(self.effects)
        count = len(block.kind)
        verdicts = Verdicts(
            np.empty((count, 4), np.int64), np.empty((count, 3)), np.zeros(1, np.int64)
        )
        follow(block.kind, block.t_us, block.values, state, verdicts)
        filled = int(verdicts.filled[0])
        rows = zip(verdicts.rows[:filled].tolist(), verdicts.figures[:filled].tolist(), strict=True)
        names = dict(enumerate(self.effects.names)) | {LOAD: "load", PITOT: "airspeed"}
        return [
            (row, _result(t_us, [names[n] for n in numbers if n != NOBODY], *figures))
            for (row, t_us, *numbers), figures in rows
        ], state


def _commanded(effects: Effects) -> Obedience:
    """The state when the first command comes."""
    counts = np.zeros(COUNTS, np.int64)
    counts[SUSPECT:CRASH_US] = NOBODY
    counts[CRASH_US] = NEVER_US
    return Obedience(
        no_cells(effects.lags_s),
        nothing_learnt(effects),
        no_outputs(),
        effects.mix,
        effects.disturbance(),
        counts,
        np.array([np.nan, BY_ITS_START if ELEVATOR in effects.names else FLIES_MPS]),
        np.full(3, np.nan),
        no_trim(),
        nothing_followed(),
    )


def _result(
    t_us: int, blamed: list[str], statistic: float, deficit: float, lost: float
) -> SensorDecision:
    name = EITHER.join(blamed)
    return SensorDecision(
        t_us=t_us,
        sensor=ACTUATORS,
        statistic=None if statistic == OFF else statistic,
        threshold=None if statistic == OFF else SURE,
        dof=AXES,
        alarm=bool(blamed),
        isolated=len(blamed) == 1,
        reason=_reason(name, deficit, lost),
        suspect=name,
    )


def _reason(name: str, deficit: float, lost: float) -> str:
    if not name:
        return ""
    if deficit == OFF:
        return f"{name}: its output is switched off in flight"
    if lost > 0.0:
        return f"{name}: follows {max(0.0, 1.0 - lost):.2f} of its command"
    if deficit == 0.0:  # nobody is suspected now, but was
        return name
    side = "below" if deficit > 0.0 else "above"
    return f"{name}: {abs(deficit):.2f} {side} its command"
