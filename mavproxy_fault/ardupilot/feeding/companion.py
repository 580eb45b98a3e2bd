"""Conversion of HIL frames that ArduPilot reads as MAVLink into its formats; no I/O.

A second GPS receiver becomes GPS_INPUT, HIL_OPTICAL_FLOW becomes OPTICAL_FLOW (`optical_flow`).
ArduPilot reads ODOMETRY only in MAV_FRAME_LOCAL_FRD. Messages other than HIL sensors (commands,
missions, messages of a companion computer) pass unchanged.
"""

import math

from mavproxy_fault.ardupilot.feeding.optical_flow import FlowInput
from mavproxy_fault.ardupilot.feeding.vectornav import GPS_EPOCH_US, SPEED_SIGMA_MPS, dilution
from mavproxy_fault.ardupilot.hil_readings import ID_GPS
from mavproxy_fault.fault_parts.elements import Element, locate_element, patch_frame
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

GPS_INPUT = message_layout("GPS_INPUT")
SHARED_GPS_FIELDS = ("time_usec", "fix_type", "satellites_visible", "lat", "lon")
PARAM_SET, REAL32 = message_layout("PARAM_SET"), 9  # MAV_PARAM_TYPE_REAL32
GROUND_STATION = 255
WEEK_US = 604_800_000_000  # of GPS time
LOCAL_NED, LOCAL_FRD = 1, 20  # MAV_FRAME_
COVARIANCES = {"ODOMETRY": "pose_covariance", "VISION_POSITION_ESTIMATE": "covariance"}
ATTITUDE_VARIANCES = 15, 18, 20  # of the upper triangle of a 6x6 matrix
UNREAD_PREFIXES = ("HIL_", "TUNNEL")  # raw pseudoranges are for the monitor only


class CompanionFeed:
    """Converts the frames sent to ArduPilot as MAVLink in one flight."""

    def __init__(self) -> None:
        self._flow = FlowInput()

    def step(self, frame: Frame, t_us: int) -> bytes | None:
        """Convert a frame received at vehicle time `t_us`; None if ArduPilot does not use it."""
        name = frame.layout.name
        if name == "HIL_GPS":
            return build_gps_input(frame) if frame.number("id") != ID_GPS else None
        if name == "HIL_OPTICAL_FLOW":
            return self._flow.step(frame, t_us)
        if name.startswith(UNREAD_PREFIXES):
            return None
        return adapt_vision_pose(frame).raw if name in COVARIANCES else frame.raw


def adapt_vision_pose(frame: Frame) -> Frame:
    """Adapt a vision pose to ArduPilot: local FRD frame, unknown attitude variance as 0.

    ArduPilot sums the attitude variances if those of the position are known, and a NaN is an
    internal error that prevents arming. It replaces a variance of 0 by VISO_YAW_M_NSE.
    """
    covariance = COVARIANCES[frame.layout.name]
    values: dict[Element, float] = {
        locate_element(frame.layout, covariance, place): 0.0
        for place in ATTITUDE_VARIANCES
        if math.isnan(frame.number(covariance, place))
    }
    if frame.layout.name == "ODOMETRY" and frame.number("frame_id") == LOCAL_NED:
        values[locate_element(frame.layout, "frame_id")] = LOCAL_FRD
    return patch_frame(frame, values)


def set_parameter(name: str, value: float) -> bytes:
    """Encode a PARAM_SET of the ground station."""
    values = {
        "target_system": 1,
        "target_component": 1,
        "param_id": name.encode(),
        "param_value": value,
        "param_type": REAL32,
    }
    return build_frame(PARAM_SET, values, system=GROUND_STATION)


def build_gps_input(frame: Frame) -> bytes:
    """Encode a HIL_GPS as GPS_INPUT with the same receiver id."""
    read = frame.number
    week, within_us = divmod(GPS_EPOCH_US + int(read("time_usec")), WEEK_US)
    horizontal_m, vertical_m = read("eph") * 0.01, read("epv") * 0.01
    values = {
        **{name: read(name) for name in SHARED_GPS_FIELDS},
        "time_week": week,
        "time_week_ms": within_us // 1000,
        "gps_id": read("id"),
        "alt": read("alt") * 1e-3,
        "hdop": dilution(horizontal_m),
        "vdop": dilution(vertical_m),
        **{name: read(name) * 0.01 for name in ("vn", "ve", "vd")},
        "speed_accuracy": SPEED_SIGMA_MPS,
        "horiz_accuracy": horizontal_m,
        "vert_accuracy": vertical_m,
    }
    return build_frame(
        GPS_INPUT, values, seq=frame.seq, system=frame.system, component=frame.component
    )
