"""Values of the MAVLink enumerations that the services use [1]_, and PX4's flight modes [2]_.

References
----------
.. [1] MAVLink common message set, https://mavlink.io/en/messages/common.html
.. [2] PX4, `px4_custom_mode.h`.
"""

from enum import IntEnum, IntFlag


class Command(IntEnum):
    """MAV_CMD."""

    WAYPOINT = 16
    LOITER_UNLIMITED = 17
    LOITER_TIME = 19
    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    DELAY = 93
    SET_MODE = 176
    CHANGE_SPEED = 178
    REPOSITION = 192
    PAUSE_CONTINUE = 193
    SET_MISSION_CURRENT = 224
    MISSION_START = 300
    ARM_DISARM = 400
    GET_HOME_POSITION = 410
    INJECT_FAILURE = 420
    GET_MESSAGE_INTERVAL = 510
    SET_MESSAGE_INTERVAL = 511
    REQUEST_MESSAGE = 512
    REQUEST_PROTOCOL_VERSION = 519
    REQUEST_AUTOPILOT_CAPABILITIES = 520


class CommandResult(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    DENIED = 2
    UNSUPPORTED = 3


class MissionResult(IntEnum):
    """MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_SEQUENCE = 13
    OPERATION_CANCELLED = 15


class MissionType(IntEnum):
    """MAV_MISSION_TYPE."""

    MISSION = 0
    ALL = 255


class CoordinateFrame(IntEnum):
    """MAV_FRAME."""

    GLOBAL = 0
    MISSION = 2
    GLOBAL_RELATIVE = 3
    GLOBAL_INT = 5
    GLOBAL_RELATIVE_INT = 6


class StandardMode(IntEnum):
    """MAV_STANDARD_MODE."""

    NON_STANDARD = 0
    SAFE_RECOVERY = 5
    MISSION = 6
    LAND = 7
    TAKEOFF = 8


class LandedState(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class SystemState(IntEnum):
    """MAV_STATE."""

    STANDBY = 3
    ACTIVE = 4


class BaseMode(IntFlag):
    """MAV_MODE_FLAG."""

    CUSTOM = 1
    AUTO = 4
    GUIDED = 8
    STABILIZED = 16
    ARMED = 128


class Capability(IntFlag):
    """MAV_PROTOCOL_CAPABILITY."""

    MISSION_INT = 4
    COMMAND_INT = 8
    PARAM_ENCODE_BYTEWISE = 16
    MAVLINK2 = 8192


class SysStatusSensor(IntFlag):
    """MAV_SYS_STATUS_SENSOR."""

    GYRO = 0x1
    ACCEL = 0x2
    MAG = 0x4
    ABSOLUTE_PRESSURE = 0x8
    GPS = 0x20
    GEOFENCE = 0x100000
    AHRS = 0x200000
    BATTERY = 0x2000000
    PREARM_CHECK = 0x10000000


class MavType(IntEnum):
    """MAV_TYPE."""

    FIXED_WING = 1
    QUADROTOR = 2
    HEXAROTOR = 13


AUTOPILOT_PX4 = 12  # MAV_AUTOPILOT_PX4
PARAM_INT32 = 6  # MAV_PARAM_TYPE_INT32
PARAM_REAL32 = 9  # MAV_PARAM_TYPE_REAL32


class FlightMode(IntEnum):
    """The supported modes as PX4 custom modes: sub mode << 24 | main mode (AUTO = 4) << 16."""

    TAKEOFF = 2 << 24 | 4 << 16
    HOLD = 3 << 24 | 4 << 16
    MISSION = 4 << 24 | 4 << 16
    RETURN = 5 << 24 | 4 << 16
    LAND = 6 << 24 | 4 << 16
