"""The operator of a flight under a real autopilot: arms it, has it fly, lands it; no I/O.

The operator waits until the estimator has had a position for a while, uploads the mission, arms,
takes off, flies the mission or waits where it is, lands, and waits for the motors to stop. What is
not answered is asked again each second of the vehicle's time.
"""

from collections.abc import Sequence
from enum import StrEnum
from typing import Protocol

from analysis.autopilots.flight_plan import FlightPlan
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from simvehicle.guidance.waypoints import Waypoint

HEARTBEAT = message_layout("HEARTBEAT")
GROUND_STATION, TYPE_GCS, NO_AUTOPILOT = 255, 6, 8
COMPONENT = 190  # MAV_COMP_ID_MISSIONPLANNER
ARMED_FLAG = 128  # MAV_MODE_FLAG_SAFETY_ARMED
POSITION, CONSTANT_POSITION = 0x10, 0x80  # EKF_STATUS_REPORT.flags, ESTIMATOR_STATUS.flags
RETRY_US = 1_000_000
OPERATOR_PERIOD_US = 40_000  # of the vehicle's time between two looks of the operator
# Streams that are recorded, and that nobody here reads
IGNORED_STREAMS = frozenset(
    message_layout(name).id for name in ("ATTITUDE", "LOCAL_POSITION_NED", "VFR_HUD", "ALTITUDE")
)
# Of a position. PX4's detector of landings needs as long to see that a plane stands: armed before,
# it takes it to fly, and banks it on the runway.
POSITION_SETTLED_US = 10_000_000
CLIMB_DONE_SHARE = 0.9  # of the height, where the take-off is over
TAKEN_OFF_M = 1.0
VEHICLE_KINDS = {1: "fixedwing"} | dict.fromkeys(
    (2, 3, 4, 13, 14, 15), "multirotor"
)  # by MAV_TYPE_
GROUNDED_LIMIT_S = (
    30.0  # on the ground with motors on, after which nothing more will come of a flight
)


class AutopilotCommands(Protocol):
    """What an autopilot is asked for, in its own words; each is asked until it is seen done."""

    @property
    def awaiting_reply(self) -> bool:
        """Whether somebody is at work on a request who lives on the wall clock."""

    def upload(self, waypoints: Sequence[Waypoint]) -> None:
        """Give it the mission."""

    def arm(self) -> None:
        """Start the motors."""

    def take_off(self, height_m: float) -> None:
        """Climb to a height above the ground."""

    def fly_mission(self) -> None:
        """Fly what was uploaded; asked once."""

    def land(self) -> None:
        """Come down."""

    def receive(self, frame: Frame) -> None:
        """Read a frame of the autopilot."""

    def pending(self) -> list[bytes]:
        """What has to be sent now."""


class Phase(StrEnum):
    """Where the flight is."""

    WAITING = "waiting for a position"
    UPLOADING = "uploading the mission"
    ARMING = "arming"
    CLIMBING = "taking off"
    FLYING = "flying"
    LANDING = "landing"
    LANDED = "landed"


PHASE_TIMEOUTS_S = {  # of the vehicle's time, for phases that the autopilot has to end
    Phase.WAITING: 180.0,
    Phase.UPLOADING: 30.0,
    Phase.ARMING: 60.0,
    Phase.CLIMBING: 60.0,
    Phase.LANDING: 300.0,  # a plane flies a pattern first
}


class Operator:
    """One flight from the ground.

    Attributes
    ----------
    phase : Phase
    moments_us : dict of str to int
        When things happened: `first-stamp`, `arming`, `take-off`, `mission-item:N`, `landing`.
    texts : list of (int, str)
        What the autopilot said, with its time [us].
    gave_up : str
        Why the flight did not go on; empty while it does.
    """

    def __init__(self, plan: FlightPlan, requests: AutopilotCommands) -> None:
        self.phase = Phase.WAITING
        self.events_us: dict[str, int] = {}
        self.texts: list[tuple[int, str]] = []
        self.failure = ""
        self._plan, self._requests = plan, requests
        self._t_us = self._since_us = self._again_us = self._hello_us = 0
        self._positioned_us: int | None = None  # since when
        self._armed = self._uploaded = self._started = False
        self._height_m = 0.0
        self._aloft_us = 0  # when it last was in the air, or had not yet been
        self._seq = 0

    @property
    def finished(self) -> bool:
        """Whether there is nothing more to do."""
        return self.phase is Phase.LANDED or bool(self.failure)

    def receive(self, frame: Frame) -> None:
        """Read a frame of the autopilot."""
        self._requests.receive(frame)
        name = frame.layout.name
        if name == "HEARTBEAT" and frame.component == 1:
            self._armed = bool(int(frame.number("base_mode")) & ARMED_FLAG)
            if self._armed:
                self._note("arming")
            flown = VEHICLE_KINDS.get(int(frame.number("type")), "")
            if flown and self._plan.kind not in ("", flown):
                self.failure = (
                    f"the autopilot says it flies a {flown}, the scenario's vehicle is a "
                    f"{self._plan.kind}; give another --binary"
                )
        elif name in ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS"):
            flags = int(frame.number("flags"))
            # PX4 sets the second flag of every vehicle on the ground
            constant = name == "EKF_STATUS_REPORT" and flags & CONSTANT_POSITION
            positioned = bool(flags & POSITION) and not constant
            if not positioned or self._positioned_us is None:
                self._positioned_us = self._t_us if positioned else None
        elif name == "GLOBAL_POSITION_INT":
            self._height_m = frame.number("relative_alt") * 1e-3
            if self._armed and self._height_m > TAKEN_OFF_M:
                self._note("take-off")
        elif name == "MISSION_ACK":
            self._uploaded = frame.number("type") == 0
        elif name == "MISSION_ITEM_REACHED":
            self._note(f"mission-item:{int(frame.number('seq'))}")
        elif name == "STATUSTEXT" and frame.component == 1:
            text = frame.read("text")
            assert isinstance(text, bytes)
            self.texts.append((self._t_us, text.decode("utf-8", "replace")))

    def step(self, t_us: int, *, on_ground: bool = False, started: bool = True) -> list[bytes]:
        """What to send at this time of the vehicle, which may truly lie on the ground.

        Before the program has `started` all of its parts, it is not armed.
        """
        self._t_us, self._started = t_us, started
        if not started:
            self._since_us = t_us  # patience is with the vehicle, not with a busy machine
        self._note("first-stamp")
        if not on_ground or "take-off" not in self.events_us:
            self._aloft_us = t_us
        self._go_on()
        if t_us >= self._again_us and not self.finished:
            self._again_us = t_us + RETRY_US
            self._ask()
        frames = self._requests.pending()
        if t_us >= self._hello_us:
            self._hello_us = t_us + RETRY_US
            frames.append(self._hello())
        return frames

    def _go_on(self) -> None:
        """The next phase, where this one has done its work or cannot."""
        while self._done():
            self._enter(list(Phase)[list(Phase).index(self.phase) + 1])
        if self.phase is Phase.FLYING and not self._armed:  # a failsafe of its own has landed it
            self._enter(Phase.LANDED)
        waited_s = (self._t_us - self._since_us) * 1e-6
        lying_s = (self._t_us - self._aloft_us) * 1e-6
        if self.phase is Phase.CLIMBING and not self._armed:
            self.failure = f"disarmed while {self.phase}"
        # Its estimator may be lost: an autopilot that has crashed would fly on for minutes.
        elif lying_s > GROUNDED_LIMIT_S and not self.finished:
            self.failure = f"on the ground for {GROUNDED_LIMIT_S:.0f} s with its motors on"
        elif waited_s > PHASE_TIMEOUTS_S.get(self.phase, float("inf")):
            self.failure = f"still {self.phase} after {waited_s:.0f} s"

    def _done(self) -> bool:
        match self.phase:
            case Phase.WAITING:
                since_us = self._positioned_us
                settled = since_us is not None and self._t_us - since_us >= POSITION_SETTLED_US
                return settled and self._started
            case Phase.UPLOADING:
                return self._uploaded or not self._plan.waypoints
            case Phase.ARMING:
                return self._armed
            case Phase.CLIMBING:
                return self._height_m > CLIMB_DONE_SHARE * self._plan.height_m
            case Phase.FLYING:
                return self._flown_s() >= self._plan.duration_s
            case Phase.LANDING:
                return not self._armed
            case _:
                return False

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._since_us = self._t_us
        self._again_us = 0
        if phase in (Phase.LANDING, Phase.LANDED):
            self._note(str(phase))

    def _flown_s(self) -> float:
        return (self._t_us - self.events_us.get("take-off", self._t_us)) * 1e-6

    def _ask(self) -> None:
        """Ask for what this phase needs."""
        plan, requests = self._plan, self._requests
        if self.phase is Phase.UPLOADING:
            requests.upload(plan.waypoints)
        elif self.phase is Phase.ARMING:
            requests.arm()
        elif self.phase is Phase.CLIMBING and self._height_m < TAKEN_OFF_M:
            requests.take_off(plan.height_m)
        elif self.phase is Phase.FLYING and plan.waypoints and self._t_us == self._since_us:
            requests.fly_mission()
        elif self.phase is Phase.LANDING:
            requests.land()

    def _hello(self) -> bytes:
        """A ground station's sign of life."""
        self._seq = (self._seq + 1) & 0xFF
        values = {"type": TYPE_GCS, "autopilot": NO_AUTOPILOT, "mavlink_version": 3}
        return build_frame(
            HEARTBEAT, values, seq=self._seq, system=GROUND_STATION, component=COMPONENT
        )

    def _note(self, moment: str) -> None:
        """Keep the first time of a moment."""
        self.events_us.setdefault(moment, self._t_us)
