"""An operator's requests as MAVSDK makes them: MAVSDK's home in a run, used for PX4.

MAVSDK has no socket here: bytes of the autopilot are handed to it, and what it wants sent leaves
with the next step, through the proxy as any ground station's. Its own threads and time-outs run on
wall time; a request that is under way or was granted is not made again.
"""

import math
from collections.abc import Callable, Sequence
from queue import Empty, SimpleQueue
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk, log_subscribe
from mavsdk.plugins.action import Action
from mavsdk.plugins.mission import Mission, MissionItem, MissionPlan

from analysis.autopilots.flight_plan import Waypoint
from mavproxy_fault.wire.frame import Frame

ACCEPTANCE_M = 2.0
GRANTED = "SUCCESS"
Answered = Callable[[Any, Any], None]  # MAVSDK's callback: a result and what was handed along


class MavsdkRequests:
    """One MAVSDK and the vehicle it finds; `close` ends its threads."""

    def __init__(self) -> None:
        log_subscribe(lambda *_: True)  # what happens is told by the operator
        station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
        self._mavsdk = Mavsdk(station)
        self._outgoing: SimpleQueue[bytes] = SimpleQueue()
        self._mavsdk.subscribe_raw_bytes_to_be_sent(self._outgoing.put)
        self._mavsdk.add_any_connection("raw://")
        self._action: Any = None
        self._mission: Any = None
        self._made: set[str] = set()  # under way or granted

    def close(self) -> None:
        """End MAVSDK."""
        self._mavsdk.destroy()

    def heard(self, frame: Frame) -> None:
        """Hand a frame on."""
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
        mission = MissionPlan([_item(waypoint) for waypoint in waypoints])
        self._request("upload", lambda done: self._mission.upload_mission_async(mission, done))

    def arm(self) -> None:
        """Arm."""
        self._request("arm", lambda done: self._action.arm_async(done))

    def take_off(self, height_m: float) -> None:
        """Set the height, then take off."""

        def climb(_: Any, __: Any) -> None:
            self._action.takeoff_async(done)

        done = self._done("take_off")
        self._request(
            "take_off", lambda _: self._action.set_takeoff_altitude_async(height_m, climb)
        )

    def fly_mission(self) -> None:
        """Start the mission."""
        self._request("fly_mission", lambda done: self._mission.start_mission_async(done))

    def land(self) -> None:
        """Land."""
        self._request("land", lambda done: self._action.land_async(done))

    def _request(self, name: str, ask: Callable[[Answered], None]) -> None:
        """Ask, unless MAVSDK has not found the vehicle or is at it already."""
        if self._action is None:
            systems = [system for system in self._mavsdk.get_systems() if system.has_autopilot()]
            if not systems:
                return
            self._action, self._mission = Action(systems[0]), Mission(systems[0])
        if name not in self._made:
            self._made.add(name)
            ask(self._done(name))

    def _done(self, name: str) -> Answered:
        """Lets a request that was refused be made again."""

        def answered(result: Any, _: Any) -> None:
            if result.name != GRANTED:
                self._made.discard(name)

        return answered


def _item(waypoint: Waypoint) -> MissionItem:
    unset = math.nan
    return MissionItem(
        latitude_deg=waypoint.lat_deg,
        longitude_deg=waypoint.lon_deg,
        relative_altitude_m=waypoint.height_m,
        speed_m_s=waypoint.speed_mps,
        is_fly_through=True,
        gimbal_pitch_deg=unset,
        gimbal_yaw_deg=unset,
        camera_action=MissionItem.CameraAction.NONE,
        loiter_time_s=unset,
        camera_photo_interval_s=unset,
        acceptance_radius_m=ACCEPTANCE_M,
        yaw_deg=unset,
        camera_photo_distance_m=unset,
        vehicle_action=MissionItem.VehicleAction.NONE,
    )
