"""Hardware in the loop: the simulation goes on in real time, whoever answers.

An autopilot on its own board has a clock of its own: its HIL_ACTUATOR_CONTROLS act when they come,
and no step waits for one.
"""

import time

from simvehicle.app.lockstep_loop import FramePacker, FrameSource, LockstepLoop, SteppedSimulation
from simvehicle.app.sim_progress import Progress
from simvehicle.hil.lockstep import SILENCE_TIMEOUT_S, AutopilotSilentError, Lockstep
from simvehicle.vehicles.actuators import Mix

OVERRUN_S = 1e-3  # a step that begins later than this is an overrun
SILENCE_WARNING_S = 1.0  # without controls, after which it is told


class FreeRunning(Lockstep):
    """A lockstep that is none: it remembers when the autopilot was heard, and waits for nothing."""

    def received(self, stamp_us: int, now_s: float) -> None:
        """Controls have come, for whatever step."""
        self.answered = True
        self._heard_s = now_s

    def wait_s(self, now_s: float) -> float:
        """No time at all.

        Raises
        ------
        AutopilotSilentError
            When controls that once came have been missing for long.
        """
        if self.silent_s(now_s) > self._silence_s:
            raise AutopilotSilentError(
                f"the autopilot has sent nothing for {SILENCE_TIMEOUT_S:g} s"
            )
        return 0.0

    def silent_s(self, now_s: float) -> float:
        """For how long controls have been missing; 0 before the first."""
        return now_s - self._heard_s if self.answered else 0.0


class Overruns:
    """Steps that began late."""

    def __init__(self) -> None:
        self.steps = self.late = 0
        self.worst_s = 0.0

    def add(self, late_s: float) -> None:
        """Count a step that began so late."""
        self.steps += 1
        self.late += late_s > OVERRUN_S
        self.worst_s = max(self.worst_s, late_s)

    def text(self) -> str:
        """One line."""
        worst_ms = self.worst_s * 1e3
        return f"{self.late} of {self.steps} steps over 1 ms late, the latest {worst_ms:.1f} ms"


class RealTimeLoop(LockstepLoop):
    """The loop without lockstep, at the pace of the clock.

    Attributes
    ----------
    overruns : Overruns
    """

    unanswered = "a board answers in its HIL mode only (PX4: SYS_HITL 1 and a HIL airframe)"
    unlocked = ""

    def __init__(
        self,
        simulation: SteppedSimulation,
        hil: FramePacker,
        inbox: FrameSource,
        mix: Mix,
        progress: Progress,
    ) -> None:
        self._free = FreeRunning()
        super().__init__(simulation, hil, inbox, mix, 1.0, progress, self._free)
        self.overruns = Overruns()
        self._mute = False  # it was told that controls are missing

    def _step(self) -> None:
        now_s = time.monotonic()
        self.overruns.add(self._pace.late_s(self.t_us, now_s))
        self._tell_silence(now_s)
        super()._step()

    def _tell_silence(self, now_s: float) -> None:
        """The vehicle flies on its last controls: nobody may take that for the autopilot's."""
        mute = self._free.silent_s(now_s) > SILENCE_WARNING_S
        if mute and not self._mute:
            self._progress.say(
                f"no controls for {SILENCE_WARNING_S:g} s; the vehicle flies on the last ones"
            )
        if self._mute and not mute:
            self._progress.say("controls come again")
        self._mute = mute
