"""An operator's requests as MAVSDK makes them: MAVSDK's home in a run, used for PX4.

MAVSDK has no socket here: bytes of the autopilot are handed to it, and what it wants sent leaves
with the next step, through the proxy as any ground station's. Its own threads and time-outs run on
wall time; a request that is under way or was granted is not made again.
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
MANUAL_MODE = {**SET_MODE, "param2": 1}  # PX4's main mode, and below it a sub-mode of it
HOLD_MODE = {**SET_MODE, "param2": 4, "param3": 3}
MANUAL_REPEATS = 3  # the height controller starts anew after a second without it
ResultCallback = Callable[[Any, Any], None]  # MAVSDK's callback: a result and what was handed along


class MavsdkCommands:
    """One MAVSDK and the vehicle it finds; `close` ends its threads.

    Parameters
    ----------
    landing : sequence of Waypoint
        A plane's way to the ground; empty for what lands where it is.
    """

    def __init__(self, landing: Sequence[Waypoint]) -> None:
        log_subscribe(lambda *_: True)  # what happens is told by the operator
        station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        self._mavsdk = Mavsdk(station)
        # MAVSDK sends from a thread of its own; the flight takes it along with its next step.
        self._outgoing: SimpleQueue[bytes] = SimpleQueue()
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._outgoing.put)
        self._mavsdk.add_any_connection("raw://")
        self._landing = landing
        self._modes_before_arming = [MANUAL_MODE] * MANUAL_REPEATS + [HOLD_MODE] if landing else []
        self._action: Any = None
        self._mission: Any = None
        self._in_progress: set[str] = set()
        self._succeeded: set[str] = set()
        self._searching = False  # no vehicle was found yet when something was to be asked

    @property
    def awaiting_reply(self) -> bool:
        """Whether MAVSDK is at a request, or still to find the vehicle for one."""
        return self._searching or bool(self._in_progress)

    def close(self) -> None:
        """End MAVSDK."""
        self._mavsdk.destroy()

    def receive(self, frame: Frame) -> None:
        """Hand a frame on, unless it is of a stream: these it asks nothing of."""
        if frame.layout.name not in STREAMS_HZ:
            self._mavsdk.pass_received_raw_bytes(frame.raw)

    def pending(self) -> list[bytes]:
        """What MAVSDK has to send."""
        found = []
        while True:
            try:
                found.append(self._outgoing.get_nowait())
            except Empty:
                return found

    def upload(self, waypoints: Sequence[Waypoint]) -> None:
        """Upload the mission."""
        self._upload("mission", waypoint_items(waypoints))

    def arm(self) -> None:
        """Arm; a plane after it was taken out of its automatic mode and back.

        PX4's height controller runs in that mode from the start, from before the estimator knew
        the height of the field, and would lead the plane up from sea level after its take-off.
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
        """Take off, to the height that PX4 was started with: MAVSDK would block to set it."""
        self._request("take_off", lambda done: self._action.takeoff_async(done))

    def fly_mission(self) -> None:
        """Start the mission."""
        self._request("start", lambda done: self._mission.start_mission_async(done))

    def land(self) -> None:
        """Land, a plane by a mission: PX4 takes the ground below it for sea level else."""
        if not self._landing:
            self._request("land", lambda done: self._action.land_async(done))
        elif "landing" not in self._succeeded:
            self._upload("landing", landing_items(self._landing))
        else:
            self._request("start landing", lambda done: self._mission.start_mission_async(done))

    def _upload(self, name: str, items: Sequence[ItemFields]) -> None:
        raw = _raw_items(items)
        self._request(name, lambda done: self._mission.upload_mission_async(raw, done))

    def _request(self, name: str, ask: Callable[[ResultCallback], None]) -> None:
        """Ask, unless MAVSDK has not found the vehicle or is at it already."""
        if self._action is None:
            systems = [system for system in self._mavsdk.get_systems() if system.has_autopilot()]
            self._searching = not systems
            if not systems:
                return
            self._action, self._mission = Action(systems[0]), MissionRaw(systems[0])
        if name not in self._in_progress | self._succeeded:
            self._in_progress.add(name)
            ask(self._done(name))

    def _done(self, name: str) -> ResultCallback:
        """Called by MAVSDK in the end; what was refused may be asked for again."""

        def answered(result: Any, _: Any) -> None:
            if result.name == RESULT_SUCCESS:
                self._succeeded.add(name)
            self._in_progress.discard(name)

        return answered


def _raw_items(items: Sequence[ItemFields]) -> list[MissionItem]:
    """Items as MAVSDK takes them."""
    return [
        MissionItem(seq=seq, current=int(seq == 0), autocontinue=1, **item)
        for seq, item in enumerate(items)
    ]
