"""Which message leaves how often, and on request."""

from collections.abc import Callable

from mavproxy_fault.wire.dialect import find_layout, message_layout
from simvehicle.autopilot import telemetry
from simvehicle.autopilot.telemetry import Snapshot
from simvehicle.hil.outgoing_message import Message

SECOND_US = 1_000_000
# Name -> what makes it and how often it leaves unasked, in microseconds (0: on request only)
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
}
# MAV_DATA_STREAM of REQUEST_DATA_STREAM -> the messages it stands for
DATA_STREAMS = {
    0: ("ATTITUDE", "GLOBAL_POSITION_INT", "GPS_RAW_INT", "VFR_HUD", "SYS_STATUS"),
    2: ("SYS_STATUS", "GPS_RAW_INT", "MISSION_CURRENT"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE",),
    11: ("VFR_HUD",),
}
SHORTEST_INTERVAL_US = 4_000  # one message per simulation step


class Streams:
    """The intervals in force and when each message is due; the state of one link."""

    def __init__(self) -> None:
        self._interval_us = {name: interval for name, (_, interval) in MESSAGE_SOURCES.items()}
        self._due_us = {name: 0 for name, interval in self._interval_us.items() if interval}

    def tick(self, now: Snapshot) -> list[Message]:
        """What is due; a message that fell behind leaves once."""
        out = []
        for name, due_us in self._due_us.items():
            if now.stamp_us >= due_us:
                interval = self._interval_us[name]
                due_us += interval
                # After a pause one message leaves, not all that were missed.
                self._due_us[name] = due_us if due_us > now.stamp_us else now.stamp_us + interval
                out.append(MESSAGE_SOURCES[name][0](now))
        return out

    def interval_us(self, number: int) -> int:
        """The interval of a message in microseconds, -1 where off, 0 where not available."""
        found = find_layout(number)
        if found is None or found.name not in MESSAGE_SOURCES:
            return 0
        # MAVLink's words: -1 is off, 0 not available.
        return self._interval_us[found.name] or -1

    def set_interval(self, number: int, interval_us: float) -> bool:
        """Set, reset (0) or stop (-1) a stream; whether the message is one of ours."""
        found = find_layout(number)
        if found is None or found.name not in MESSAGE_SOURCES:
            return False
        name = found.name
        if interval_us == 0:
            interval_us = MESSAGE_SOURCES[name][1]
        # Never faster than the simulation steps.
        self._interval_us[name] = (
            max(round(interval_us), SHORTEST_INTERVAL_US) if interval_us > 0 else 0
        )
        if self._interval_us[name]:
            # Due at once: who asks for a stream wants to see it.
            self._due_us[name] = 0
        else:
            self._due_us.pop(name, None)
        return True

    def make_requested(self, number: int, now: Snapshot) -> list[Message]:
        """A message once; nothing where it is not one of ours."""
        found = find_layout(number)
        source = MESSAGE_SOURCES.get(found.name) if found else None
        return [source[0](now)] if source else []

    def make_stream_message(self, name: str, now: Snapshot) -> Message:
        """A message of ours by name."""
        return MESSAGE_SOURCES[name][0](now)

    def set_data_stream(self, stream: int, rate_hz: float, start: bool) -> None:
        """The old way to set rates: REQUEST_DATA_STREAM, which has no answer."""
        for name in DATA_STREAMS.get(stream, ()):
            # -1 stops a stream.
            self.set_interval(
                message_layout(name).id, SECOND_US / rate_hz if start and rate_hz > 0 else -1
            )
