"""Message rates: which telemetry message is sent how often, or on request."""

from collections.abc import Callable

from mavproxy_fault.wire.dialect import find_layout, message_layout
from simvehicle.autopilot import telemetry
from simvehicle.autopilot.telemetry import Snapshot
from simvehicle.hil.hil_messages import Message

SECOND_US = 1_000_000
# Name -> the function that builds it and its default interval in us (0: on request only)
MESSAGE_SOURCES: dict[str, tuple[Callable[[Snapshot], Message], int]] = {
    "HEARTBEAT": (telemetry.heartbeat, SECOND_US),
    "SYS_STATUS": (telemetry.sys_status, SECOND_US // 2),
    "ATTITUDE": (telemetry.attitude, SECOND_US // 20),
    "ATTITUDE_QUATERNION": (telemetry.attitude_quaternion, SECOND_US // 20),
    "GLOBAL_POSITION_INT": (telemetry.global_position_int, SECOND_US // 10),
    "LOCAL_POSITION_NED": (telemetry.local_position_ned, SECOND_US // 10),
    "GPS_RAW_INT": (telemetry.gps_raw_int, SECOND_US // 5),
    "VFR_HUD": (telemetry.vfr_hud, SECOND_US // 5),
    "ALTITUDE": (telemetry.altitude, SECOND_US // 5),
    "HOME_POSITION": (telemetry.home_position, SECOND_US),
    "EXTENDED_SYS_STATE": (telemetry.extended_sys_state, SECOND_US // 2),
    "BATTERY_STATUS": (telemetry.battery_status, SECOND_US),
    "SYSTEM_TIME": (telemetry.system_time, SECOND_US),
    "MISSION_CURRENT": (telemetry.mission_current, SECOND_US),
    "AUTOPILOT_VERSION": (telemetry.autopilot_version, 0),
    "CURRENT_MODE": (telemetry.current_mode, 0),
    "PROTOCOL_VERSION": (telemetry.protocol_version, 0),
}
# MAV_DATA_STREAM of REQUEST_DATA_STREAM -> the messages that it selects
DATA_STREAMS = {
    0: ("ATTITUDE", "GLOBAL_POSITION_INT", "GPS_RAW_INT", "VFR_HUD", "SYS_STATUS"),
    2: ("SYS_STATUS", "GPS_RAW_INT", "MISSION_CURRENT"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE",),
    11: ("VFR_HUD",),
}
SHORTEST_INTERVAL_US = 4_000  # one message per simulation step


class Streams:
    """The interval and due time of each message on one link."""

    def __init__(self) -> None:
        self._interval_us = {name: interval for name, (_, interval) in MESSAGE_SOURCES.items()}
        self._due_us = {name: 0 for name, interval in self._interval_us.items() if interval}

    def tick(self, snapshot: Snapshot) -> list[Message]:
        """The messages due; a message that fell behind is sent once."""
        out = []
        for name, due_us in self._due_us.items():
            if snapshot.stamp_us >= due_us:
                interval = self._interval_us[name]
                due_us += interval
                # After a pause one message is sent, not all the missed ones.
                self._due_us[name] = (
                    due_us if due_us > snapshot.stamp_us else snapshot.stamp_us + interval
                )
                out.append(MESSAGE_SOURCES[name][0](snapshot))
        return out

    def interval_us(self, number: int) -> int:
        """The interval of a message in microseconds, -1 where off, 0 where not available."""
        name = _source_name(number)
        return 0 if name is None else self._interval_us[name] or -1

    def set_interval(self, number: int, interval_us: float) -> bool:
        """Set, reset (0) or stop (-1) a stream; returns False for an unsupported message."""
        name = _source_name(number)
        if name is None:
            return False
        if interval_us == 0:
            interval_us = MESSAGE_SOURCES[name][1]
        # Never faster than the simulation's steps.
        self._interval_us[name] = (
            max(round(interval_us), SHORTEST_INTERVAL_US) if interval_us > 0 else 0
        )
        if self._interval_us[name]:
            # The first message of a requested stream is due at once.
            self._due_us[name] = 0
        else:
            self._due_us.pop(name, None)
        return True

    def make_requested(self, number: int, snapshot: Snapshot) -> list[Message]:
        """Build a message by its number, once; empty for an unsupported message."""
        name = _source_name(number)
        return [] if name is None else [MESSAGE_SOURCES[name][0](snapshot)]

    def set_data_stream(self, stream: int, rate_hz: float, start: bool) -> None:
        """Apply the deprecated REQUEST_DATA_STREAM, which has no answer."""
        for name in DATA_STREAMS.get(stream, ()):
            # -1 stops a stream.
            self.set_interval(
                message_layout(name).id, SECOND_US / rate_hz if start and rate_hz > 0 else -1
            )


def _source_name(number: int) -> str | None:
    """The name of a message that can be sent; None for any other."""
    layout = find_layout(number)
    return layout.name if layout is not None and layout.name in MESSAGE_SOURCES else None
