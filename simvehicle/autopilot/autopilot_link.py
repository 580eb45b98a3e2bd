"""The autopilot's services for a ground station, as a core without I/O.

`received` takes a frame and `tick` advances time; both return the frames to send. The vehicle
identifies as PX4 and answers as PX4 does. `CommandedFlight` sets the goal that the built-in
controller follows.
"""

from collections.abc import Callable, Iterable

from mavproxy_fault.wire.frame import Frame, build_frame
from simvehicle.autopilot import telemetry
from simvehicle.autopilot.command_service import Commands
from simvehicle.autopilot.enums import MavType
from simvehicle.autopilot.flight_goals import CommandedFlight
from simvehicle.autopilot.mission_service import Missions
from simvehicle.autopilot.parameter_service import Parameters
from simvehicle.autopilot.streams import Streams
from simvehicle.autopilot.telemetry import Snapshot
from simvehicle.hil.hil_frames import START_US
from simvehicle.hil.hil_messages import Message, drawn_mah, make_message
from simvehicle.sensors.readings import BatteryReading, GpsReading, Reading
from simvehicle.vehicles.body import Truth

PARAMETER_MESSAGES = {"PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"}
MISSION_MESSAGES = {
    "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ITEM", "MISSION_REQUEST_LIST",
    "MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_CLEAR_ALL",
}  # fmt: skip
FTP_NAK, FTP_FAIL = 129, 1  # opcode and error of the MAVLink FTP protocol
AUTOPILOT_COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1


class AutopilotLink:
    """The services of one vehicle on one link.

    Parameters
    ----------
    flight, parameters, missions
        The state that the services read and change.
    fail_motor : callable
        Stops (True) or starts a motor by its number, from 1, or 0 for all; returns False if there
        is no such motor.
    mav_type : MavType
        Reported in the heartbeat.
    system : int
        The vehicle's system id; it sends as component 1.
    start_us : int
        The vehicle's clock at the simulation's t_us = 0.
    """

    def __init__(
        self,
        flight: CommandedFlight,
        parameters: Parameters,
        missions: Missions,
        fail_motor: Callable[[int, bool], bool],
        mav_type: MavType = MavType.QUADROTOR,
        system: int = 1,
        start_us: int = START_US,
    ) -> None:
        self._flight = flight
        self._parameters = parameters
        self._missions = missions
        self._streams = Streams()
        self._commands = Commands(flight, self._streams, parameters, fail_motor)
        self._mav_type = mav_type
        self._system = system
        self._start_us = start_us
        self._seq = 0
        # Nothing is answered before the first step, as there is no state to report yet.
        self._snapshot: Snapshot | None = None
        self._gps: GpsReading | None = None
        self._battery: BatteryReading | None = None
        self._consumed_mah = 0.0

    def tick(
        self, t_us: int, truth: Truth, readings: Iterable[Reading], throttle: float
    ) -> list[bytes]:
        """The telemetry due at `t_us` and the flight's own messages; throttle is 0 to 1."""
        for reading in readings:
            # An autopilot reports its first receiver.
            if isinstance(reading, GpsReading) and reading.id == 0:
                self._gps = reading
            elif isinstance(reading, BatteryReading):
                self._consumed_mah += drawn_mah(self._battery, reading)
                self._battery = reading
        messages = self._flight.advance(truth)
        self._snapshot = Snapshot(
            stamp_us=t_us + self._start_us,
            truth=truth,
            gps=self._gps,
            # Without a battery monitor, the battery's true state.
            battery=self._battery
            or BatteryReading(t_us, truth.battery_v, truth.battery_a, truth.battery_remaining),
            consumed_mah=self._consumed_mah,
            home=self._flight.home,
            mode=self._flight.mode,
            armed=self._flight.armed,
            landed=self._flight.landed,
            mav_type=self._mav_type,
            throttle=throttle,
            # 0 means not supported: the scenario's path is flown without item numbers.
            mission_count=len(self._missions.items) if self._flight.goal_active else 0,
            mission_seq=self._flight.seq,
        )
        messages += self._missions.tick(t_us)
        return [self.pack(m) for m in messages + self._streams.tick(self._snapshot)]

    def received(self, frame: Frame, t_us: int) -> list[bytes]:
        """The answers to one frame; none before the first `tick` or to other vehicles' frames."""
        if self._snapshot is None or not self._is_for_us(frame):
            return []
        return [self.pack(m) for m in self._answer(frame, t_us, self._snapshot)]

    def _answer(self, frame: Frame, t_us: int, snapshot: Snapshot) -> list[Message]:
        name = frame.layout.name
        if name in ("COMMAND_LONG", "COMMAND_INT"):
            return self._commands.received(frame, snapshot)
        if name in PARAMETER_MESSAGES:
            return self._parameters.received(frame)
        if name in MISSION_MESSAGES:
            return self._missions.received(frame, t_us)
        if name == "MISSION_SET_CURRENT":
            # SET_CURRENT has no acknowledgement: MISSION_CURRENT is the answer.
            self._flight.set_current(int(frame.number("seq")))
            return [telemetry.mission_current(snapshot)]
        if name == "SET_MODE":
            self._commands.set_mode(frame)
        elif name == "REQUEST_DATA_STREAM":
            self._streams.set_data_stream(
                int(frame.number("req_stream_id")),
                float(frame.number("req_message_rate")),
                bool(frame.number("start_stop")),
            )
        elif name == "TIMESYNC":
            return answer_timesync(frame, snapshot.stamp_us)
        elif name == "FILE_TRANSFER_PROTOCOL":
            return [refuse_ftp(frame)]
        return []

    def _is_for_us(self, frame: Frame) -> bool:
        fields = frame.layout.fields
        system = frame.number("target_system") if "target_system" in fields else 0
        component = frame.number("target_component") if "target_component" in fields else 0
        # 0 is MAVLink's "to all".
        return system in (0, self._system) and component in (0, AUTOPILOT_COMPONENT)

    def pack(self, content: Message) -> bytes:
        """The frame of a message, numbered in the one sequence of all that the autopilot sends."""
        layout, values = content
        seq = self._seq
        # The sequence number is a byte.
        self._seq = (seq + 1) & 0xFF
        return build_frame(
            layout, values, seq=seq, system=self._system, component=AUTOPILOT_COMPONENT
        )


def answer_timesync(frame: Frame, stamp_us: int) -> list[Message]:
    """Answer a TIMESYNC request (tc1 = 0) with the vehicle's clock [ns]; ignore answers."""
    if frame.number("tc1") != 0:
        return []
    return [make_message("TIMESYNC", tc1=stamp_us * 1000, ts1=frame.number("ts1"))]


def refuse_ftp(frame: Frame) -> Message:
    """Reject a file transfer request with a NAK, so that the client continues without files.

    Payload: sequence (2), session, opcode, size, requested opcode, burst, padding, offset (4),
    data; the first data byte of a NAK is the error [1]_.

    References
    ----------
    .. [1] MAVLink developer guide, "File Transfer Protocol".
    """
    sent = [int(frame.number("payload", i)) for i in range(6)]
    # The answer's sequence number is one above the request's.
    seq = (sent[0] | sent[1] << 8) + 1 & 0xFFFF
    payload = [seq & 0xFF, seq >> 8, sent[2], FTP_NAK, 1, sent[3], 0, 0, 0, 0, 0, 0, FTP_FAIL]
    return make_message(
        "FILE_TRANSFER_PROTOCOL",
        target_network=0,
        target_system=frame.system,
        target_component=frame.component,
        payload=payload,
    )
