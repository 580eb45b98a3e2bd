"""Who flies an ArduPilot from the ground: plain MAVLink, one step after the other; no I/O.

The operator waits until the estimator has a position, uploads the mission, arms, takes off, flies
the mission or waits where it is, lands, and waits for the motors to stop. What is not answered is
asked again each second of the vehicle's time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from mavproxy_fault.wire.dialect import Layout, known
from mavproxy_fault.wire.frame import Frame, build

COMMAND_LONG, MISSION_COUNT = known("COMMAND_LONG"), known("MISSION_COUNT")
MISSION_ITEM_INT = known("MISSION_ITEM_INT")
HEARTBEAT = known("HEARTBEAT")
GROUND_STATION, TYPE_GCS, NO_AUTOPILOT = 255, 6, 8
COMPONENT = 190  # MAV_COMP_ID_MISSIONPLANNER
WAYPOINT, TAKE_OFF, SET_MODE, ARM, START = 16, 22, 176, 400, 300  # MAV_CMD_
CUSTOM_MODE, ARMED = 1, 128  # MAV_MODE_FLAG_
GLOBAL_RELATIVE_INT = 6  # MAV_FRAME_
POSITION, CONSTANT_POSITION = 0x10, 0x80  # EKF_STATUS_REPORT.flags
AGAIN_US = 1_000_000
REACHED = 0.9  # of the height, where the take-off is over
OFF_THE_GROUND_M = 1.0


class Phase(StrEnum):
    """Where the flight is."""

    WAITING = "waiting for a position"
    UPLOADING = "uploading the mission"
    ARMING = "arming"
    CLIMBING = "taking off"
    FLYING = "flying"
    LANDING = "landing"
    LANDED = "landed"


PATIENCE_S = {  # of the vehicle's time, for phases that the autopilot has to end
    Phase.WAITING: 180.0,
    Phase.UPLOADING: 30.0,
    Phase.ARMING: 60.0,
    Phase.CLIMBING: 60.0,
    Phase.LANDING: 300.0,  # a plane flies a pattern first
}


@dataclass(frozen=True, slots=True)
class Modes:
    """Custom modes of a kind of ArduPilot; a plane's TAKEOFF mode needs no command to take off."""

    take_off: int
    auto: int
    land: int
    take_off_command: bool


COPTER = Modes(take_off=4, auto=3, land=9, take_off_command=True)  # GUIDED, AUTO, LAND
PLANE = Modes(take_off=13, auto=10, land=26, take_off_command=False)  # TAKEOFF, AUTO, AUTOLAND


@dataclass(frozen=True, slots=True)
class Waypoint:
    """One corner of a mission."""

    lat_deg: float
    lon_deg: float
    height_m: float


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """What is flown: up, along the corners (or nowhere), and after `duration_s` down."""

    height_m: float
    duration_s: float  # from leaving the ground
    waypoints: tuple[Waypoint, ...] = ()
    modes: Modes = COPTER


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

    def __init__(self, plan: FlightPlan) -> None:
        self.phase = Phase.WAITING
        self.moments_us: dict[str, int] = {}
        self.texts: list[tuple[int, str]] = []
        self.gave_up = ""
        self._plan = plan
        self._t_us = self._since_us = self._again_us = self._hello_us = 0
        self._positioned = self._armed = self._uploaded = False
        self._height_m = 0.0
        self._seq = 0
        self._asked_items: list[int] = []

    @property
    def over(self) -> bool:
        """Whether there is nothing more to do."""
        return self.phase is Phase.LANDED or bool(self.gave_up)

    def heard(self, frame: Frame) -> None:
        """Read a frame of the autopilot."""
        name = frame.layout.name
        if name == "HEARTBEAT" and frame.component == 1:
            self._armed = bool(int(frame.number("base_mode")) & ARMED)
            if self._armed:
                self._note("arming")
        elif name == "EKF_STATUS_REPORT":
            flags = int(frame.number("flags"))
            self._positioned = bool(flags & POSITION) and not flags & CONSTANT_POSITION
        elif name == "GLOBAL_POSITION_INT":
            self._height_m = frame.number("relative_alt") * 1e-3
            if self._armed and self._height_m > OFF_THE_GROUND_M:
                self._note("take-off")
        elif name in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and self._plan.waypoints:
            self._asked_items.append(int(frame.number("seq")))
        elif name == "MISSION_ACK":
            self._uploaded = frame.number("type") == 0
        elif name == "MISSION_ITEM_REACHED":
            self._note(f"mission-item:{int(frame.number('seq'))}")
        elif name == "STATUSTEXT" and frame.component == 1:
            text = frame.read("text")
            assert isinstance(text, bytes)
            self.texts.append((self._t_us, text.decode("utf-8", "replace")))

    def step(self, t_us: int) -> list[bytes]:
        """What to send at this time of the vehicle."""
        self._t_us = t_us
        self._note("first-stamp")
        frames = [self._item(number) for number in self._asked_items]
        self._asked_items = []
        self._go_on()
        if t_us >= self._hello_us:
            self._hello_us = t_us + AGAIN_US
            hello = {"type": TYPE_GCS, "autopilot": NO_AUTOPILOT, "mavlink_version": 3}
            frames.append(self._frame(HEARTBEAT, hello))
        if t_us >= self._again_us and not self.over:
            self._again_us = t_us + AGAIN_US
            frames += self._asks()
        return frames

    def _go_on(self) -> None:
        """The next phase, where this one has done its work or cannot."""
        while self._done():
            self._enter(list(Phase)[list(Phase).index(self.phase) + 1])
        if self.phase is Phase.FLYING and not self._armed:  # a failsafe of its own has landed it
            self._enter(Phase.LANDED)
        waited_s = (self._t_us - self._since_us) * 1e-6
        if self.phase is Phase.CLIMBING and not self._armed:
            self.gave_up = f"disarmed while {self.phase}"
        elif waited_s > PATIENCE_S.get(self.phase, float("inf")):
            self.gave_up = f"still {self.phase} after {waited_s:.0f} s"

    def _done(self) -> bool:
        return {
            Phase.WAITING: self._positioned,
            Phase.UPLOADING: self._uploaded or not self._plan.waypoints,
            Phase.ARMING: self._armed,
            Phase.CLIMBING: self._height_m > REACHED * self._plan.height_m,
            Phase.FLYING: self._flown_s() >= self._plan.duration_s,
            Phase.LANDING: not self._armed,
            Phase.LANDED: False,
        }[self.phase]

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._since_us = self._t_us
        self._again_us = 0
        if phase in (Phase.LANDING, Phase.LANDED):
            self._note(str(phase))

    def _flown_s(self) -> float:
        return (self._t_us - self.moments_us.get("take-off", self._t_us)) * 1e-6

    def _asks(self) -> list[bytes]:
        """What this phase asks of the autopilot."""
        plan = self._plan
        if self.phase is Phase.UPLOADING:
            count = {"target_system": 1, "target_component": 1, "count": len(plan.waypoints) + 1}
            return [self._frame(MISSION_COUNT, count)]
        if self.phase is Phase.ARMING:
            return [self._mode(plan.modes.take_off), self._command(ARM, 1.0)]
        if self.phase is Phase.CLIMBING and self._height_m < OFF_THE_GROUND_M:
            if not plan.modes.take_off_command:
                return []
            return [self._command(TAKE_OFF, 0, 0, 0, 0, 0, 0, plan.height_m)]
        if self.phase is Phase.FLYING and plan.waypoints and self._flown_s() < plan.duration_s:
            began = self._t_us == self._since_us
            return [self._mode(plan.modes.auto), self._command(START)] if began else []
        return [self._mode(plan.modes.land)] if self.phase is Phase.LANDING else []

    def _item(self, number: int) -> bytes:
        """A mission item; the first is the home that ArduPilot keeps for itself."""
        corners: Sequence[Waypoint] = self._plan.waypoints
        corner = corners[min(max(number - 1, 0), len(corners) - 1)]
        values = {
            "target_system": 1,
            "target_component": 1,
            "seq": number,
            "frame": GLOBAL_RELATIVE_INT,
            "command": WAYPOINT,
            "autocontinue": 1,
            "x": round(corner.lat_deg * 1e7),
            "y": round(corner.lon_deg * 1e7),
            "z": corner.height_m,
        }
        return self._frame(MISSION_ITEM_INT, values)

    def _mode(self, number: int) -> bytes:
        return self._command(SET_MODE, CUSTOM_MODE, number)

    def _command(self, number: int, *parameters: float) -> bytes:
        values: dict[str, object] = {f"param{n}": value for n, value in enumerate(parameters, 1)}
        values |= {"command": number, "target_system": 1, "target_component": 1}
        return self._frame(COMMAND_LONG, values)

    def _frame(self, layout: Layout, values: Mapping[str, object]) -> bytes:
        self._seq = (self._seq + 1) & 0xFF
        return build(layout, values, seq=self._seq, system=GROUND_STATION, component=COMPONENT)

    def _note(self, moment: str) -> None:
        """Keep the first time of a moment."""
        self.moments_us.setdefault(moment, self._t_us)
