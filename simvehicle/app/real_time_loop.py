"""Hardware in the loop: the simulation runs in real time and waits for no answer.

An autopilot on its own board has its own clock: its HIL_ACTUATOR_CONTROLS take effect on arrival.
"""

import time

from simvehicle.app.lockstep_loop import FramePacker, FrameSource, LockstepLoop
from simvehicle.app.sim_progress import Progress
from simvehicle.hil.lockstep import Lockstep
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.actuators import Mix

OVERRUN_S = 1e-3  # a step that starts later is an overrun; chosen: a quarter of the IMU's 4 ms step
SILENCE_WARNING_S = 1.0  # without controls, until a warning; chosen: hundreds of missed steps


class FreeRunning(Lockstep):
    """Replaces lockstep: it records when the autopilot was last heard and never waits."""

    def received(self, stamp_us: int, now_s: float) -> None:
        """Record that controls have arrived, for whichever step."""
        super().received(stamp_us, now_s)
        self.locked = False

    def silent_s(self, now_s: float) -> float:
        """Seconds since the last controls; 0 before the first."""
        return now_s - self._heard_s if self.answered else 0.0


class Overruns:
    """Counts the steps that started late."""

    def __init__(self) -> None:
        self.steps = self.late = 0
        self.worst_s = 0.0

    def add(self, late_s: float) -> None:
        """Count a step that started `late_s` seconds late."""
        self.steps += 1
        self.late += late_s > OVERRUN_S
        self.worst_s = max(self.worst_s, late_s)

    def text(self) -> str:
        """The counts as one line of text."""
        worst_ms = self.worst_s * 1e3
        return (
            f"{self.late} of {self.steps} steps more than 1 ms late, the worst by {worst_ms:.1f} ms"
        )


class RealTimeLoop(LockstepLoop):
    """The loop without lockstep, paced by the wall clock.

    Attributes
    ----------
    overruns : Overruns
    """

    unanswered = "switch the board to HIL mode (PX4: set SYS_HITL to 1 and select a HIL airframe)"
    unlocked = ""

    def __init__(
        self,
        simulation: Simulation,
        hil: FramePacker,
        inbox: FrameSource,
        mix: Mix,
        progress: Progress,
    ) -> None:
        self._free = FreeRunning()
        super().__init__(simulation, hil, inbox, mix, 1.0, progress, self._free)
        self.overruns = Overruns()
        self._silent = False  # the missing controls have been reported

    def _step(self) -> None:
        now_s = time.monotonic()
        self.overruns.add(self._pace.late_s(self.t_us, now_s))
        self._report_silence(now_s)
        super()._step()

    def _report_silence(self, now_s: float) -> None:
        """Report when controls stop and resume, as the vehicle keeps the last ones meanwhile."""
        silent = self._free.silent_s(now_s) > SILENCE_WARNING_S
        if silent and not self._silent:
            self._progress.say(
                f"no controls for {SILENCE_WARNING_S:g} s; the vehicle flies on the last ones"
            )
        if self._silent and not silent:
            self._progress.say("receiving controls again")
        self._silent = silent
