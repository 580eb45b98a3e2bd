"""Scripted ground operator of a flight under an autopilot; no I/O.

The operator waits for a settled position estimate, uploads the mission, arms, takes off, flies the
mission or hovers, lands, and waits for the motors to stop. Commands without an answer are repeated
every second of vehicle time.
"""

from enum import StrEnum

from analysis.autopilots.flight_plan import FlightPlan
from analysis.autopilots.operator_commands import COMPONENT, GROUND_STATION, OperatorCommands
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

HEARTBEAT = message_layout("HEARTBEAT")
TYPE_GCS, NO_AUTOPILOT = 6, 8
ARMED_FLAG = 128  # MAV_MODE_FLAG_SAFETY_ARMED
POSITION, CONSTANT_POSITION = 0x10, 0x80  # EKF_STATUS_REPORT.flags, ESTIMATOR_STATUS.flags
RETRY_US = 1_000_000
# Vehicle time at whose multiples the vehicle is armed: how soon an autopilot is ready depends on
# the machine, and with it the noise at which a fault begins.
ARMING_PERIOD_US = 10_000_000
OPERATOR_PERIOD_US = 40_000  # vehicle time between two steps of the operator
# Streams that are recorded, but that the operator does not need
IGNORED_STREAMS = frozenset(
    message_layout(name).id for name in ("ATTITUDE", "LOCAL_POSITION_NED", "VFR_HUD", "ALTITUDE")
)
# PX4's land detector needs as long to find that a plane is at rest: if armed earlier, PX4 believes
# that it flies, and banks it on the runway.
POSITION_SETTLED_US = 10_000_000
CLIMB_DONE_SHARE = 0.9  # of the take-off height, at which the take-off is complete
TAKEN_OFF_M = 1.0
IN_AIR = 2  # MAV_LANDED_STATE_IN_AIR
# A vehicle in the air that has not changed its height by more than STEADY_M for so long has ended
# its climb, whatever height its estimate says: a barometer may drift between home and take-off.
STEADY_US, STEADY_M = 10_000_000, 0.5
VEHICLE_KINDS = {1: "fixedwing"} | dict.fromkeys(
    (2, 3, 4, 13, 14, 15), "multirotor"
)  # by MAV_TYPE_
REST_S = 2.0  # on the ground, so that what hit it with its motors off is recorded to its end
# After an upload and at each change of mode PX4 reads up to three items of a mission, and waits for
# each for a second at most.
READING_US = 3_000_000
# Without a frame for ten of PX4's heartbeats its threads of low priority do not run, nor does it
# read ours: after 10 s it would return for want of a ground station.
SILENT_US = 1_000_000
GROUNDED_LIMIT_S = 30.0  # on the ground with motors on: the vehicle has crashed


class Phase(StrEnum):
    """The phase of the operator's script."""

    WAITING = "waiting for a position"
    UPLOADING = "uploading the mission"
    ARMING = "arming"
    CLIMBING = "taking off"
    FLYING = "flying"
    LANDING = "landing"
    LANDED = "landed"


PHASE_TIMEOUTS_S = {  # vehicle time, for phases that the autopilot has to end
    Phase.WAITING: 180.0,
    Phase.UPLOADING: 30.0,
    Phase.ARMING: 180.0,  # on a busy machine ArduPilot refuses for a while: its loop is slow
    Phase.CLIMBING: 60.0,
    Phase.LANDING: 300.0,  # a plane flies a pattern first
}


class Operator:
    """The operator of one flight.

    Attributes
    ----------
    phase : Phase
    events_us : dict of str to int
        Vehicle time of the flight events `first-stamp`, `arming`, `take-off`, `mission-item:N` and
        `landing`.
    texts : list of (int, str)
        Status texts of the autopilot with their time [us].
    failure : str
        Why the operator ended the flight; empty otherwise.
    """

    def __init__(self, plan: FlightPlan, commands: OperatorCommands) -> None:
        self.phase = Phase.WAITING
        self.events_us: dict[str, int] = {}
        self.texts: list[tuple[int, str]] = []
        self.failure = ""
        self._plan, self._commands = plan, commands
        self._t_us = self._phase_since_us = self._retry_us = self._heartbeat_us = 0
        self._heard_us = 0  # when the last frame was received
        self._position_since_us: int | None = None  # start of the position estimate
        self._armed = self._uploaded = self._started = False
        self._height_m = self._steady_height_m = 0.0
        self._steady_since_us: int | None = None  # since when it is in the air at this height
        self._asked_item = -1  # the highest mission item that the vehicle has requested
        self._airborne_us = 0  # last time in the air or before the take-off
        self._on_ground = False
        self._seq = 0

    @property
    def finished(self) -> bool:
        """Whether the flight has landed or failed."""
        return self.phase is Phase.LANDED or bool(self.failure)

    @property
    def needs_time(self) -> bool:
        """Whether the autopilot stores or reads a mission, or falls behind with its telemetry."""
        reads = self.phase is Phase.UPLOADING or self._t_us - self._phase_since_us < READING_US
        late = self._t_us - self._heard_us > SILENT_US
        return late or (self._commands.has_mission and reads)

    def receive(self, frame: Frame) -> None:
        """Read a frame of the autopilot."""
        self._commands.receive(frame)
        self._heard_us = self._t_us
        name = frame.layout.name
        if name == "HEARTBEAT" and frame.component == 1:
            self._armed = bool(int(frame.number("base_mode")) & ARMED_FLAG)
            if self._armed:
                self._note_event("arming")
            kind = VEHICLE_KINDS.get(int(frame.number("type")), "")
            if kind and self._plan.kind not in ("", kind):
                self.failure = (
                    f"the autopilot reports a {kind}, but the scenario's vehicle is a "
                    f"{self._plan.kind}; give another --binary"
                )
        elif name in ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS"):
            flags = int(frame.number("flags"))
            # PX4 sets the second flag for every vehicle on the ground
            constant = name == "EKF_STATUS_REPORT" and flags & CONSTANT_POSITION
            has_position = bool(flags & POSITION) and not constant
            if not has_position or self._position_since_us is None:
                self._position_since_us = self._t_us if has_position else None
        elif name == "GLOBAL_POSITION_INT":
            self._height_m = frame.number("relative_alt") * 1e-3
            if self._armed and self._height_m > TAKEN_OFF_M:
                self._note_event("take-off")
            if abs(self._height_m - self._steady_height_m) > STEADY_M:
                self._steady_height_m, self._steady_since_us = self._height_m, None
        elif name == "EXTENDED_SYS_STATE":
            if not self._armed or frame.number("landed_state") != IN_AIR:
                self._steady_since_us = None
            elif self._steady_since_us is None:
                self._steady_since_us = self._t_us
        elif name in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            # Each further item is progress; the time-out counts from the last one.
            if frame.number("seq") > self._asked_item and self.phase is Phase.UPLOADING:
                self._asked_item, self._phase_since_us = int(frame.number("seq")), self._t_us
        elif name == "MISSION_ACK":
            # An item sent twice is answered by an error after the mission was accepted.
            self._uploaded |= frame.number("type") == 0
        elif name == "MISSION_ITEM_REACHED":
            self._note_event(f"mission-item:{int(frame.number('seq'))}")
        elif name == "STATUSTEXT" and frame.component == 1:
            text = frame.read("text")
            assert isinstance(text, bytes)
            self.texts.append((self._t_us, text.decode("utf-8", "replace")))

    def step(self, t_us: int, *, on_ground: bool = False, started: bool = True) -> list[bytes]:
        """Advance to vehicle time `t_us` and return the frames to send.

        `on_ground` is the truth; the vehicle is not armed before the autopilot has `started`.
        """
        self._t_us, self._started, self._on_ground = t_us, started, on_ground
        if not started:
            self._phase_since_us = t_us  # the timeouts do not cover the start of the autopilot
        self._note_event("first-stamp")
        if not on_ground or "take-off" not in self.events_us:
            self._airborne_us = t_us
        self._advance_phase()
        if t_us >= self._retry_us and not self.finished:
            self._retry_us = t_us + RETRY_US
            self._send_command()
        frames = self._commands.pending()
        if t_us >= self._heartbeat_us:
            self._heartbeat_us = t_us + RETRY_US
            frames.append(self._heartbeat())
        return frames

    def _advance_phase(self) -> None:
        """Enter the next phase if this one is complete, or note its failure."""
        while self._phase_complete():
            self._enter(list(Phase)[list(Phase).index(self.phase) + 1])
        if self.phase is Phase.FLYING and self._ended():  # its own failsafe has landed it
            self._enter(Phase.LANDED)
        waited_s = (self._t_us - self._phase_since_us) * 1e-6
        grounded_s = (self._t_us - self._airborne_us) * 1e-6
        if self.phase is Phase.CLIMBING and self._ended():
            self.failure = f"disarmed while {self.phase}"
        # With a diverged estimator, a crashed autopilot would continue for minutes.
        elif grounded_s > GROUNDED_LIMIT_S and not self.finished:
            self.failure = f"on the ground for {GROUNDED_LIMIT_S:.0f} s with its motors on"
        elif waited_s > PHASE_TIMEOUTS_S.get(self.phase, float("inf")):
            said = f": {self.texts[-1][1]}" if self.texts else ""
            self.failure = f"still {self.phase} after {waited_s:.0f} s{said}"

    def _phase_complete(self) -> bool:
        match self.phase:
            case Phase.WAITING:
                since_us = self._position_since_us
                settled = since_us is not None and self._t_us - since_us >= POSITION_SETTLED_US
                return settled and self._started
            case Phase.UPLOADING:
                return self._uploaded or not self._commands.has_mission
            case Phase.ARMING:
                return self._armed
            case Phase.CLIMBING:
                return self._height_m > CLIMB_DONE_SHARE * self._plan.height_m or self._hovers()
            case Phase.FLYING:
                return self._airborne_s() >= self._plan.duration_s
            case Phase.LANDING:
                return self._ended()
            case _:
                return False

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._phase_since_us = self._t_us
        self._retry_us = 0
        if phase is Phase.ARMING:
            self._retry_us = -(-self._t_us // ARMING_PERIOD_US) * ARMING_PERIOD_US
        if phase in (Phase.LANDING, Phase.LANDED):
            self._note_event(str(phase))

    def _ended(self) -> bool:
        """Whether the vehicle is disarmed at rest; one that is disarmed in the air falls first."""
        rests = self._t_us - self._airborne_us >= REST_S * 1e6 or "take-off" not in self.events_us
        return not self._armed and self._on_ground and rests

    def _hovers(self) -> bool:
        """Whether the autopilot says that it is in the air, and its height no longer changes."""
        since_us = self._steady_since_us
        hovers = since_us is not None and self._t_us - since_us >= STEADY_US
        if hovers:
            self._note_event("take-off")
        return hovers

    def _airborne_s(self) -> float:
        return (self._t_us - self.events_us.get("take-off", self._t_us)) * 1e-6

    def _send_command(self) -> None:
        """Send the command of this phase."""
        plan, commands = self._plan, self._commands
        if self.phase is Phase.UPLOADING:
            commands.upload()
        elif self.phase is Phase.ARMING:
            commands.arm()
        elif self.phase is Phase.CLIMBING and self._height_m < TAKEN_OFF_M:
            commands.take_off(plan.height_m)
        elif self.phase is Phase.FLYING and plan.waypoints and self._t_us == self._phase_since_us:
            commands.fly_mission()
        elif self.phase is Phase.LANDING:
            commands.land()

    def _heartbeat(self) -> bytes:
        """Return a ground-station HEARTBEAT."""
        self._seq = (self._seq + 1) & 0xFF
        values = {"type": TYPE_GCS, "autopilot": NO_AUTOPILOT, "mavlink_version": 3}
        return build_frame(
            HEARTBEAT, values, seq=self._seq, system=GROUND_STATION, component=COMPONENT
        )

    def _note_event(self, event: str) -> None:
        """Record the first time of a flight event."""
        self.events_us.setdefault(event, self._t_us)
