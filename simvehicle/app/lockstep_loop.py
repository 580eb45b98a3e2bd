"""The loop that flies the simulation under an autopilot on the HIL link, in lockstep."""

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
from simvehicle.hil.plant_changes import ChangeablePlant, PlantChanges
from simvehicle.sensors.readings import Reading
from simvehicle.vehicles.actuators import CHANNEL_COUNT, Mix, read_controls
from simvehicle.vehicles.body import Controls, Truth

RESTART_ADVICE = (
    "it, or the proxy before it, may have died; start simulator, proxy and autopilot anew "
    "together, for PX4 does not connect a second time"
)
STALE_AUTOPILOT_ADVICE = (
    "an autopilot that flew before this simulator was started has to be started anew, and a proxy "
    "with it: its clock does not go back"
)
FIRST_MESSAGE_TIMEOUT_S = 5.0  # after which a peer that only listens is served too
FIRST_ANSWER_TIMEOUT_S = (
    15.0  # after which it is told that none comes; PX4 needs three, a busy machine ten
)


class SteppedSimulation(ChangeablePlant, Protocol):
    """What the loop needs of a simulation."""

    def step(self, controls: Controls) -> tuple[int, Truth, Sequence[Reading]]:
        """One step: its instant, the truth and what was measured."""

    def prepare(self) -> None:
        """Do what can be done of the next step before its controls are there."""


class FramePacker(Protocol):
    """What the loop needs to tell of a step; `simvehicle.hil.hil_frames.HilPacker` is one."""

    start_us: int
    step_us: int | None  # the stamp that the autopilot answers, of the last frames; None: nobody

    def frames(self, t_us: int, truth: Truth, readings: Sequence[Reading]) -> list[bytes]:
        """The frames of a step."""


class FrameSource(Protocol):
    """What the loop needs to hear an autopilot; `Inbox` is one."""

    link: Link

    def frames(self, wait_s: float = 0.0) -> list[Frame]:
        """What has come since the last call, after waiting so long at most for something."""


class PlainStepper(Protocol):
    """What flies plain steps in the loop's place; `simvehicle.plain` says what those are."""

    def fly(self, controls: Controls, flown: Callable[[Truth], None]) -> Controls:
        """Fly on until a step needs the loop, whose answer is still to come.

        Takes the controls of the last answer, gives back those of the newest one, and tells
        `flown` of where it has come now and then.
        """


class PeerGoneError(RuntimeError):
    """The autopilot closed the link."""


class LockstepLoop:
    """One autopilot flown from its first word to its last.

    Parameters
    ----------
    simulation : Simulated
    hil : Packer
        Packs the frames.
    inbox : Incoming
        The HIL link.
    mix : Mix
        Channels to actuators.
    speed : float
        Times real time, infinite for as fast as the autopilot answers.
    lockstep : Lockstep, optional
        One that somebody else tells of answers too.
    plain : Plain, optional
        Flies plain steps at full speed, while the autopilot answers.

    Attributes
    ----------
    unanswered, unlocked : str
        What is added where no answer ever came, and to the progress while steps wait for none.
    """

    unanswered = STALE_AUTOPILOT_ADVICE
    unlocked = ", not in lockstep"

    def __init__(
        self,
        simulation: SteppedSimulation,
        hil: FramePacker,
        inbox: FrameSource,
        mix: Mix,
        speed: float,
        progress: Progress,
        lockstep: Lockstep | None = None,
        plain: PlainStepper | None = None,
    ) -> None:
        self.t_us = 0
        self.lockstep = lockstep or Lockstep()
        self._simulation = simulation
        self._hil = hil
        self._inbox = inbox
        self._changes = PlantChanges(simulation, progress.say)
        self._battery = BatteryWarnings(progress.say)
        self._mix = mix
        self._progress = progress
        self._controls = Controls(
            mix([0.0] * CHANNEL_COUNT), armed=False
        )  # until PX4's first answer
        self._speed = speed
        self._plain = plain if math.isinf(speed) else None
        self._locked = False
        self._pace = Pace(min(speed, 1.0))
        self._answer_due_s: float | None = None  # the first; None where no more has to be told

    @property
    def armed(self) -> bool:
        """Whether the autopilot's motors are on."""
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
        """Wait for a peer and its first word: PX4 speaks first."""
        link = self._inbox.link
        self._progress.say(f"{link.name}: waiting for an autopilot")
        connected_s: float | None = None
        while True:
            # A connection or a byte wakes it; else it looks again for the time-out.
            for frame in self._inbox.frames(0.2):
                self._receive(frame)
            # Bytes, for a word that is not for the simulator does not come in as a frame.
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
        # Sent in one piece: an autopilot must not be woken by half a step.
        self._inbox.link.write(b"".join(self._hil.frames(self.t_us, truth, readings)))
        now_s = time.monotonic()
        self.lockstep.sent(self._hil.step_us, now_s)
        # Whatever need not be done before, while the autopilot works.
        self._flown(truth)
        self._simulation.prepare()
        if self._plain is not None and self._locked:
            self._controls = self._plain.fly(self._controls, self._flown)
            now_s = time.monotonic()
        self._await_answer()
        if self._answer_due_s is not None and now_s > self._answer_due_s:
            self._answer_due_s = None
            if not self.lockstep.answered:
                self._progress.say(f"no answer for {FIRST_ANSWER_TIMEOUT_S:g} s; {self.unanswered}")
        self._progress.step(self.t_us, now_s, "" if self._locked else self.unlocked)

    def _flown(self, truth: Truth) -> None:
        self.t_us = truth.t_us
        self._battery.update(truth)

    def _await_answer(self) -> None:
        """Take what comes until the step is answered, its time-out is over and the pace allows."""
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
        """At most real time while nobody is waited for, and a new start of the clock."""
        self._locked = locked
        # Faster than real time only while an autopilot keeps up by answering.
        self._pace = Pace(self._speed if locked else min(self._speed, 1.0))
        stamp_s = (self.t_us + self._hil.start_us) * 1e-6
        if locked:
            self._progress.say(f"in lockstep from {stamp_s:.3f} s")
            if self._answer_due_s is not None and self.armed:
                self._progress.say(f"its motors are on already; {STALE_AUTOPILOT_ADVICE}")
            self._answer_due_s = None
        else:
            self._progress.say(
                f"no answer to the step at {stamp_s:.3f} s; going on in real time on the last "
                "commands"
            )

    def _receive(self, frame: Frame) -> None:
        if frame.layout.name == "HIL_ACTUATOR_CONTROLS":
            # Controls and their stamp: the stamp says which step was answered.
            stamp_us, self._controls = read_controls(frame, self._mix)
            self.lockstep.received(stamp_us, time.monotonic())
            return
        self._changes.carry_out(frame)


def serve_autopilot(loop: LockstepLoop, progress: Progress, until_us: int | None) -> int:
    """Run the loop; the exit code, 1 when the autopilot went away while it was needed."""
    try:
        loop.run(until_us)
    except (PeerGoneError, AutopilotSilentError) as gone:
        armed = ", with its motors on" if loop.armed else ""
        progress.say(f"{gone} after {loop.t_us * 1e-6:.3f} s of flight{armed}")
        progress.say(RESTART_ADVICE)
        # Without an end of its own a flight is over when the autopilot leaves on the ground.
        over = until_us is None and isinstance(gone, PeerGoneError) and not loop.armed
        return 0 if over else 1
    return 0
