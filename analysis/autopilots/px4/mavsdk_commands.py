"""The operator's commands by MAVSDK, used for PX4.

MAVSDK has no socket here: it receives the autopilot's bytes from the run, and its own bytes leave
with the next step through the proxy, like those of any ground station. Its threads and timeouts run
on wall time; a command that is in progress or has succeeded is not repeated.
"""

from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk, log_subscribe
from mavsdk.plugins.action import Action
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw

from analysis.autopilots.flight_operator import COMPONENT, GROUND_STATION
from analysis.autopilots.mission_items import ItemFields, landing_items, waypoint_items
from analysis.autopilots.px4.px4_parameters import STREAMS_HZ
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from simvehicle.guidance.waypoints import Waypoint

RESULT_SUCCESS = "SUCCESS"
SET_MODE = {"command": 176, "target_system": 1, "target_component": 1, "param1": 1}  # MAV_CMD_
MANUAL_MODE = {**SET_MODE, "param2": 1}  # PX4's main mode; HOLD_MODE adds a sub-mode
HOLD_MODE = {**SET_MODE, "param2": 4, "param3": 3}
MANUAL_REPEATS = 3  # seconds; the height controller restarts after one without it
ResultCallback = Callable[[Any, Any], None]  # MAVSDK's callback: a result and user data


class MavsdkCommands:
    """One MAVSDK instance and the vehicle it finds; `close` ends its threads.

    Parameters
    ----------
    landing : sequence of Waypoint
        Landing approach of a plane; empty for a vehicle that lands vertically.
    """

    def __init__(self, landing: Sequence[Waypoint]) -> None:
        log_subscribe(lambda *_: True)  # silence MAVSDK: the operator reports progress
        station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        self._mavsdk = Mavsdk(station)
        # MAVSDK sends from its own thread; the bytes leave with the next step.
        self._outgoing: SimpleQueue[bytes] = SimpleQueue()
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._outgoing.put)
        self._mavsdk.add_any_connection("raw://")
        self._landing = landing
        self._modes_before_arming = [MANUAL_MODE] * MANUAL_REPEATS + [HOLD_MODE] if landing else []
        self._action: Any = None
        self._mission: Any = None
        self._in_progress: set[str] = set()
        self._succeeded: set[str] = set()
        self._searching = False  # no vehicle was found yet for a command

    @property
    def awaiting_reply(self) -> bool:
        """Whether a command is in progress in MAVSDK, or waits for it to find the vehicle."""
        return self._searching or bool(self._in_progress)

    def close(self) -> None:
        """Stop MAVSDK."""
        self._mavsdk.destroy()

    def receive(self, frame: Frame) -> None:
        """Pass a frame to MAVSDK, unless it belongs to a stream, which no command needs."""
        if frame.layout.name not in STREAMS_HZ:
            self._mavsdk.pass_received_raw_bytes(frame.raw)

    def pending(self) -> list[bytes]:
        """Return and clear the frames that MAVSDK wants to send."""
        frames = []
        while True:
            try:
                frames.append(self._outgoing.get_nowait())
            except Empty:
                return frames

    def upload(self, waypoints: Sequence[Waypoint]) -> None:
        """Upload the mission."""
        self._upload("mission", waypoint_items(waypoints))

    def arm(self) -> None:
        """Arm; a plane is first switched to manual mode and back.

        In its automatic mode, PX4's height controller runs from before the estimator knew the
        elevation of the field, and would start the climb from sea level.
        """
        if self._modes_before_arming:
            mode = self._modes_before_arming.pop(0)
            self._outgoing.put(
                build_frame(
                    message_layout("COMMAND_LONG"), mode, system=GROUND_STATION, component=COMPONENT
                )
            )
            return
        self._request("arm", lambda done: self._action.arm_async(done))

    def take_off(self, height_m: float) -> None:
        """Take off to PX4's `MIS_TAKEOFF_ALT`: setting a height in MAVSDK would block."""
        self._request("take_off", lambda done: self._action.takeoff_async(done))

    def fly_mission(self) -> None:
        """Start the mission."""
        self._request("start", lambda done: self._mission.start_mission_async(done))

    def land(self) -> None:
        """Land; a plane by a mission, since PX4's land mode assumes a field at sea level."""
        if not self._landing:
            self._request("land", lambda done: self._action.land_async(done))
        elif "landing" not in self._succeeded:
            self._upload("landing", landing_items(self._landing))
        else:
            self._request("start landing", lambda done: self._mission.start_mission_async(done))

    def _upload(self, name: str, items: Sequence[ItemFields]) -> None:
        raw = _raw_items(items)
        self._request(name, lambda done: self._mission.upload_mission_async(raw, done))

    def _request(self, name: str, start: Callable[[ResultCallback], None]) -> None:
        """Send a command, unless no vehicle was found yet or it is already in progress."""
        if self._action is None:
            systems = [system for system in self._mavsdk.get_systems() if system.has_autopilot()]
            self._searching = not systems
            if not systems:
                return
            self._action, self._mission = Action(systems[0]), MissionRaw(systems[0])
        if name not in self._in_progress | self._succeeded:
            self._in_progress.add(name)
            start(self._result_callback(name))

    def _result_callback(self, name: str) -> ResultCallback:
        """Return MAVSDK's callback for a command; a refused command may be repeated."""

        def on_result(result: Any, _: Any) -> None:
            if result.name == RESULT_SUCCESS:
                self._succeeded.add(name)
            self._in_progress.discard(name)

        return on_result


def _raw_items(items: Sequence[ItemFields]) -> list[MissionItem]:
    """Convert items to MAVSDK's type."""
    return [
        MissionItem(seq=seq, current=int(seq == 0), autocontinue=1, **item)
        for seq, item in enumerate(items)
    ]
