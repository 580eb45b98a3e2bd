"""The mission service: upload, download, clear [1]_; `flight_goals` tracks the current item.

Only missions are stored. Geofences and rally points are not supported: an upload is refused as
unsupported and a download is empty.

References
----------
.. [1] MAVLink developer guide, "Mission Protocol".
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from mavproxy_fault.wire.frame import Frame as WireFrame
from simvehicle.autopilot.enums import Command, CoordinateFrame, MissionResult, MissionType
from simvehicle.guidance.waypoints import Waypoint
from simvehicle.hil.hil_messages import Message, make_message

MAX_ITEMS = 1000  # chosen: bounds the memory that a peer can claim
RETRY_US = 500_000  # a request for an item is repeated after this
RETRIES = 6  # chosen: the upload is given up after 3 s of silence

GLOBAL_FRAMES = (CoordinateFrame.GLOBAL, CoordinateFrame.GLOBAL_INT)
RELATIVE_FRAMES = (CoordinateFrame.GLOBAL_RELATIVE, CoordinateFrame.GLOBAL_RELATIVE_INT)
POSITION_COMMANDS = (
    Command.WAYPOINT, Command.LOITER_UNLIMITED, Command.LOITER_TIME, Command.LAND, Command.TAKEOFF,
)  # fmt: skip
SUPPORTED_COMMANDS = (
    *POSITION_COMMANDS,
    Command.RETURN_TO_LAUNCH,
    Command.DELAY,
    Command.CHANGE_SPEED,
)


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One mission item; `x_degE7`, `y_degE7` are latitude and longitude, `frame` defines `z_m`."""

    command: int
    frame: int
    params: tuple[float, float, float, float]
    x_degE7: int
    y_degE7: int
    z_m: float
    autocontinue: int = 1

    @property
    def relative(self) -> bool:
        """Whether `z_m` is relative to home instead of mean sea level."""
        return self.frame in RELATIVE_FRAMES

    def values(self, scale: float = 1) -> dict[str, float]:
        """The fields of MISSION_ITEM_INT; of MISSION_ITEM with the `scale` of its position."""
        return {
            "frame": self.frame,
            "command": self.command,
            "autocontinue": self.autocontinue,
            **{f"param{i}": value for i, value in enumerate(self.params, 1)},
            "x": self.x_degE7 * scale,
            "y": self.y_degE7 * scale,
            "z": self.z_m,
        }


@dataclass(frozen=True, slots=True)
class MissionUpload:
    """An upload in progress: its sender, the items received so far and the last request's time."""

    system: int
    component: int
    count: int
    items: tuple[MissionItem, ...] = ()
    requested_us: int = 0
    retries: int = 0


@dataclass
class Missions:
    """The stored mission, and the upload in progress if there is one.

    `revision` counts the missions accepted, so that the flight notices a new one.
    """

    items: tuple[MissionItem, ...] = ()
    revision: int = 0
    upload: MissionUpload | None = field(default=None, repr=False)

    def received(self, frame: WireFrame, t_us: int) -> list[Message]:
        """Answer one message of the mission protocol."""
        name = frame.layout.name
        kind = int(frame.number("mission_type"))
        if name == "MISSION_COUNT":
            return self._count(frame, kind, t_us)
        if name in ("MISSION_ITEM_INT", "MISSION_ITEM"):
            return self._item(frame, kind, t_us)
        # For fences and rally points: an empty list, not an error.
        if name == "MISSION_REQUEST_LIST":
            count = len(self.items) if kind == MissionType.MISSION else 0
            return [_reply_message(frame, "MISSION_COUNT", count=count, mission_type=kind)]
        if name in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            return self._request(frame, kind)
        if name == "MISSION_CLEAR_ALL":
            if kind in (MissionType.MISSION, MissionType.ALL):
                # Clearing is a new revision too, so that the flight notices it.
                self._accept(())
            return [_ack(frame, MissionResult.ACCEPTED, kind)]
        return []

    def tick(self, t_us: int) -> list[Message]:
        """Repeat the request for a missing item; cancel the upload after `RETRIES`."""
        upload = self.upload
        # The vehicle requests every item, so it also detects the loss of one.
        if upload is None or t_us - upload.requested_us < RETRY_US:
            return []
        # Report the cancellation, so that the sender does not wait forever.
        if upload.retries == RETRIES:
            self.upload = None
            return [
                make_message(
                    "MISSION_ACK",
                    target_system=upload.system,
                    target_component=upload.component,
                    type=MissionResult.OPERATION_CANCELLED,
                )
            ]
        self.upload = replace(upload, requested_us=t_us, retries=upload.retries + 1)
        return [_request_item(self.upload)]

    def _count(self, frame: WireFrame, kind: int, t_us: int) -> list[Message]:
        count = int(frame.number("count"))
        if kind != MissionType.MISSION:
            # Clearing an empty list is not an error.
            result = MissionResult.UNSUPPORTED if count else MissionResult.ACCEPTED
            return [_ack(frame, result, kind)]
        if count > MAX_ITEMS:
            return [_ack(frame, MissionResult.NO_SPACE, kind)]
        if count == 0:
            self._accept(())
            return [_ack(frame, MissionResult.ACCEPTED, kind)]
        self.upload = MissionUpload(frame.system, frame.component, count, requested_us=t_us)
        return [_request_item(self.upload)]

    def _item(self, frame: WireFrame, kind: int, t_us: int) -> list[Message]:
        upload = self.upload
        if upload is None or kind != MissionType.MISSION:
            # An item without a request.
            return [_ack(frame, MissionResult.ERROR, kind)]
        seq = int(frame.number("seq"))
        if seq < len(upload.items):  # already stored: the answer to a repeated request
            return []
        # A later item: the requested one was lost or reordered.
        if seq > len(upload.items):
            return [_request_item(upload)]
        item = read_item(frame)
        # One invalid item rejects the mission: a partial mission must not be flown.
        error = check_item(item)
        if error is not None:
            self.upload = None
            return [_ack(frame, error, kind)]
        upload = replace(upload, items=(*upload.items, item), requested_us=t_us, retries=0)
        if len(upload.items) < upload.count:
            self.upload = upload
            return [_request_item(upload)]
        self._accept(upload.items)
        return [_ack(frame, MissionResult.ACCEPTED, kind)]

    def _request(self, frame: WireFrame, kind: int) -> list[Message]:
        seq = int(frame.number("seq"))
        if kind != MissionType.MISSION or seq >= len(self.items):
            return [_ack(frame, MissionResult.INVALID_SEQUENCE, kind)]
        # Answer in the requested encoding; old ground stations support floats only.
        integer = frame.layout.name == "MISSION_REQUEST_INT"
        name, scale = ("MISSION_ITEM_INT", 1) if integer else ("MISSION_ITEM", 1e-7)
        return [_reply_message(frame, name, seq=seq, **self.items[seq].values(scale))]

    def _accept(self, items: tuple[MissionItem, ...]) -> None:
        self.items = items
        self.revision += 1
        self.upload = None


def waypoint_items(waypoints: Sequence[Waypoint]) -> tuple[MissionItem, ...]:
    """Convert waypoints to mission items, with a CHANGE_SPEED item where the speed changes."""
    items: list[MissionItem] = []
    speed_mps = math.nan
    for point in waypoints:
        if point.speed_mps != speed_mps:
            speed_mps = point.speed_mps
            # 1: speed over ground; throttle -1: unchanged.
            params = (1.0, speed_mps, -1.0, 0.0)
            items.append(
                MissionItem(Command.CHANGE_SPEED, CoordinateFrame.MISSION, params, 0, 0, 0.0)
            )
        items.append(
            MissionItem(
                Command.WAYPOINT,
                CoordinateFrame.GLOBAL_RELATIVE_INT,
                (0.0, 0.0, 0.0, math.nan),
                round(point.lat_deg * 1e7),
                round(point.lon_deg * 1e7),
                point.height_m,
            )
        )
    return tuple(items)


def read_item(frame: WireFrame) -> MissionItem:
    """The item in a MISSION_ITEM_INT, or a MISSION_ITEM with its position in degrees."""
    x, y = frame.number("x"), frame.number("y")
    if frame.layout.name == "MISSION_ITEM":
        # NaN is "here" in an item of floats, as 0, 0 is.
        x, y = (round(v * 1e7) if math.isfinite(v) else 0 for v in (x, y))
    return MissionItem(
        int(frame.number("command")),
        int(frame.number("frame")),
        tuple(float(frame.number(f"param{i}")) for i in range(1, 5)),  # type: ignore[arg-type]
        int(x),
        int(y),
        float(frame.number("z")),
        int(frame.number("autocontinue")),
    )


def check_item(item: MissionItem) -> MissionResult | None:
    """The reason for rejecting an item, or None if it can be flown."""
    if item.command not in SUPPORTED_COMMANDS:
        return MissionResult.UNSUPPORTED
    if item.command not in POSITION_COMMANDS:
        return None
    if item.frame not in GLOBAL_FRAMES + RELATIVE_FRAMES:
        return MissionResult.UNSUPPORTED_FRAME
    # 90 and 180 degrees, scaled by 1e7.
    if abs(item.x_degE7) > 900_000_000:
        return MissionResult.INVALID_PARAM5_X
    if abs(item.y_degE7) > 1_800_000_000:
        return MissionResult.INVALID_PARAM6_Y
    return None if math.isfinite(item.z_m) else MissionResult.INVALID


def _request_item(upload: MissionUpload) -> Message:
    return make_message(
        "MISSION_REQUEST_INT",
        target_system=upload.system,
        target_component=upload.component,
        seq=len(upload.items),
    )


def _ack(frame: WireFrame, result: MissionResult, kind: int) -> Message:
    return _reply_message(frame, "MISSION_ACK", type=result, mission_type=kind)


def _reply_message(to: WireFrame, name: str, /, **values: object) -> Message:
    """A message addressed to the sender of a frame."""
    return make_message(name, target_system=to.system, target_component=to.component, **values)
