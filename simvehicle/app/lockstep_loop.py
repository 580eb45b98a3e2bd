"""The loop that runs the simulation with an autopilot on the HIL link, in lockstep."""

import math
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from mavproxy_fault.links.link import Link
from mavproxy_fault.wire.frame import Frame
from simvehicle.app.battery_warnings import BatteryWarnings
from simvehicle.app.pace import Pace
from simvehicle.app.sim_progress import Progress
from simvehicle.hil.lockstep import AutopilotSilentError, Lockstep
from simvehicle.hil.plant_changes import PlantChanges
from simvehicle.sensors.readings import Reading
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.actuators import CHANNEL_COUNT, Mix, read_controls
from simvehicle.vehicles.body import Controls, Truth

RESTART_ADVICE = (
    "the autopilot or the proxy may have crashed; restart simulator, proxy and autopilot together, "
    "as PX4 does not reconnect"
)
STALE_AUTOPILOT_ADVICE = (
    "if the autopilot ran before this simulator started, restart it and the proxy: the autopilot's "
    "clock cannot go back"
)
FIRST_MESSAGE_TIMEOUT_S = 5.0  # after this a connected peer that only listens is served too
FIRST_ANSWER_TIMEOUT_S = 15.0  # until a warning; PX4 needs 3 s to start, a busy machine 10 s


class FramePacker(Protocol):
    """Packs a step into frames; implemented by `simvehicle.hil.hil_frames.HilPacker`."""

    start_us: int
    step_us: int | None  # timestamp of the last frames that the autopilot answers, None without one

    def frames(self, readings: Sequence[Reading]) -> list[bytes]:
        """Pack the frames of the simulation's last step with the readings delivered at it."""


class FrameSource(Protocol):
    """Receives frames of an autopilot; implemented by `Inbox`."""

    link: Link

    def frames(self, wait_s: float = 0.0) -> list[Frame]:
        """The frames received since the last call; waits at most `wait_s` for the first."""


class Stretcher(Protocol):
    """Runs stretches of steps in compiled code instead of the loop."""

    def fly(self, controls: Controls, flown: Callable[[Truth], None]) -> Controls:
        """Step until a step needs the loop; the answer to that step is still outstanding.

        Takes the controls of the last answer, returns those of the newest one, and calls `flown`
        with the current truth from time to time.
        """


class PeerGoneError(RuntimeError):
    """The autopilot closed the link."""


class LockstepLoop:
    """Runs the simulation with one autopilot, from its first message to its last.

    Parameters
    ----------
    simulation, hil, inbox
        What is stepped, what packs its frames, and the frames of the HIL link.
    mix : Mix
        Maps autopilot channels to actuators.
    speed : float
        Multiple of real time; infinite for as fast as the autopilot answers.
    lockstep : Lockstep, optional
        A `Lockstep` shared with other code that receives answers.
    stretches : Stretcher, optional
        Runs stretches of steps at full speed while the autopilot answers.

    Attributes
    ----------
    unanswered, unlocked : str
        Advice if no answer ever comes, and the progress note while steps wait for no answer.
    """

    unanswered = STALE_AUTOPILOT_ADVICE
    unlocked = ", not in lockstep"

    def __init__(
        self,
        simulation: Simulation,
        hil: FramePacker,
        inbox: FrameSource,
        mix: Mix,
        speed: float,
        progress: Progress,
        lockstep: Lockstep | None = None,
        stretches: Stretcher | None = None,
    ) -> None:
        self.t_us = 0
        self.lockstep = lockstep or Lockstep()
        self._simulation = simulation
        self._hil = hil
        self._inbox = inbox
        self._changes = PlantChanges(simulation.plant, progress.say)
        self._battery = BatteryWarnings(progress.say)
        self._mix = mix
        self._progress = progress
        # Until PX4's first answer
        self._controls = Controls(mix([0.0] * CHANNEL_COUNT), armed=False)
        self._speed = speed
        self._stretches = stretches if math.isinf(speed) else None
        self._locked = False
        self._pace = Pace(min(speed, 1.0))
        self._answer_due_s: float | None = None  # of the first answer; None once reported

    @property
    def armed(self) -> bool:
        """Whether the autopilot has armed the motors."""
        return self._controls.armed

    def run(self, until_us: int | None = None) -> None:
        """Step until the autopilot goes away or `until_us` is reached.

        Raises
        ------
        PeerGoneError, AutopilotSilentError
            The autopilot closed the link, or no longer answers.
        """
        self._await_autopilot()
        while until_us is None or self.t_us < until_us:
            self._check_peer()
            self._step()

    def _await_autopilot(self) -> None:
        """Wait for a peer and its first message: PX4 speaks first."""
        link = self._inbox.link
        self._progress.say(f"{link.name}: waiting for an autopilot")
        connected_s: float | None = None
        while True:
            # A connection or a byte ends the wait early; otherwise check the timeout again.
            for frame in self._inbox.frames(0.2):
                self._receive(frame)
            # Count bytes: a message that is not for the simulator is no frame in the inbox.
            if link.counters.bytes_in:
                break
            now_s = time.monotonic()
            if link.peer_count and connected_s is None:
                connected_s = now_s
            if connected_s is not None and now_s - connected_s > FIRST_MESSAGE_TIMEOUT_S:
                break
        self._progress.say(f"{link.name}: connected")
        self._answer_due_s = time.monotonic() + FIRST_ANSWER_TIMEOUT_S

    def _step(self) -> None:
        self.t_us, truth, readings = self._simulation.step(self._controls)
        # Sent in one write: half a step must not wake the autopilot.
        self._inbox.link.write(b"".join(self._hil.frames(readings)))
        now_s = time.monotonic()
        self.lockstep.sent(self._hil.step_us, now_s)
        # The rest runs while the autopilot computes its answer.
        self._update_truth(truth)
        self._simulation.prepare()
        if self._stretches is not None and self._locked:
            self._controls = self._stretches.fly(self._controls, self._update_truth)
            now_s = time.monotonic()
        self._await_answer()
        if self._answer_due_s is not None and now_s > self._answer_due_s:
            self._answer_due_s = None
            if not self.lockstep.answered:
                self._progress.say(f"no answer for {FIRST_ANSWER_TIMEOUT_S:g} s; {self.unanswered}")
        self._progress.step(self.t_us, now_s, "" if self._locked else self.unlocked)

    def _update_truth(self, truth: Truth) -> None:
        self.t_us = truth.t_us
        self._battery.update(truth)

    def _await_answer(self) -> None:
        """Receive frames until the step is answered or timed out and the pace allows the next."""
        wait_s = self._wait_s()
        while True:
            for frame in self._inbox.frames(wait_s):
                self._receive(frame)
            wait_s = self._wait_s()
            # Answered, timed out or not awaited, and the pace allows the next step.
            if wait_s == 0.0:
                return
            self._check_peer()

    def _check_peer(self) -> None:
        link = self._inbox.link
        if not link.peer_count:
            raise PeerGoneError(f"{link.name}: the autopilot closed the link")

    def _wait_s(self) -> float:
        now_s = time.monotonic()
        answer_s = self.lockstep.wait_s(now_s)
        if self.lockstep.locked != self._locked:
            self._change_pace(self.lockstep.locked)
        return max(answer_s, self._pace.wait_s(self.t_us, now_s))

    def _change_pace(self, locked: bool) -> None:
        """Restart the pace; outside lockstep it runs at real time at most."""
        self._locked = locked
        # Faster than real time only while an autopilot keeps up by answering.
        self._pace = Pace(self._speed if locked else min(self._speed, 1.0))
        stamp_s = (self.t_us + self._hil.start_us) * 1e-6
        if locked:
            self._progress.say(f"in lockstep from {stamp_s:.3f} s")
            if self._answer_due_s is not None and self.armed:
                self._progress.say(
                    f"warning: the motors are already armed; {STALE_AUTOPILOT_ADVICE}"
                )
            self._answer_due_s = None
        else:
            self._progress.say(
                f"no answer to the step at {stamp_s:.3f} s; continuing in real time with the last "
                "commands"
            )

    def _receive(self, frame: Frame) -> None:
        if frame.layout.name == "HIL_ACTUATOR_CONTROLS":
            # The timestamp identifies the step that this message answers.
            stamp_us, self._controls = read_controls(frame, self._mix)
            self.lockstep.received(stamp_us, time.monotonic())
            return
        self._changes.carry_out(frame)


def serve_autopilot(loop: LockstepLoop, progress: Progress, until_us: int | None) -> int:
    """Run the loop; returns the exit code, 1 if the autopilot was lost during the flight."""
    try:
        loop.run(until_us)
    except (PeerGoneError, AutopilotSilentError) as gone:
        armed = ", with the motors on" if loop.armed else ""
        progress.say(f"{gone} after {loop.t_us * 1e-6:.3f} s of flight{armed}")
        progress.say(RESTART_ADVICE)
        # A flight without an end time is over when the autopilot disconnects on the ground.
        over = until_us is None and isinstance(gone, PeerGoneError) and not loop.armed
        return 0 if over else 1
    return 0
