"""Preparation of ArduPilot before arming: parameter check and calibrations; no I/O.

Devices that are new to SITL must be calibrated before arming. Both calibrations need a vehicle at
rest: the simple accelerometer calibration, and that of the compass from a known heading.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mavproxy_fault.ardupilot.hil_readings import TrueState
from mavproxy_fault.ardupilot.outputs import COMPONENT
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

COMMAND_LONG = message_layout("COMMAND_LONG")
PARAM_REQUEST_READ = message_layout("PARAM_REQUEST_READ")
PREFLIGHT_CALIBRATION, SET_MESSAGE_INTERVAL, FIXED_MAG_CAL_YAW = 241, 511, 42006  # MAV_CMD_
STREAM_INTERVALS_US = {  # requested from a board, which streams nothing by itself: 6 kB/s
    "SERVO_OUTPUT_RAW": 10_000.0,
    "GLOBAL_POSITION_INT": 200_000.0,
    "ATTITUDE": 100_000.0,
    "EKF_STATUS_REPORT": 500_000.0,
}
SIMPLE_ACCEL = 4.0  # PREFLIGHT_CALIBRATION.param5
ACCEPTED = 0  # MAV_RESULT_
TO_AUTOPILOT = {"target_system": 1, "target_component": 1}
REPEAT_US = 1_000_000  # chosen: prompt at start-up without flooding a board

REQUIRED_PARAMETERS = {"AHRS_EKF_TYPE": 3.0, "EAHRS_TYPE": 1.0}


@dataclass(frozen=True, slots=True)
class SetupRequest:
    """One frame to ArduPilot, and a predicate that recognizes its answer."""

    name: str
    raw: bytes
    answered: Callable[[Frame], bool]


class Preparation:
    """Sends requests one after the other, each repeated until it is answered.

    Parameters
    ----------
    at_rest : TrueState
        Position and heading of the vehicle at rest.
    first : sequence of SetupRequest
        Requests to send before the standard ones.
    """

    def __init__(self, at_rest: TrueState, first: Sequence[SetupRequest] = ()) -> None:
        accelerometer = {"param5": SIMPLE_ACCEL}
        lat_deg, lon_deg = at_rest.lat_e7 * 1e-7, at_rest.lon_e7 * 1e-7
        compass = {"param1": at_rest.yaw_deg, "param3": lat_deg, "param4": lon_deg}
        self._pending = [
            *first,
            *map(_read_back, REQUIRED_PARAMETERS),
            _command("accelerometer calibration", PREFLIGHT_CALIBRATION, accelerometer),
            _command("compass calibration", FIXED_MAG_CAL_YAW, compass),
        ]
        self._again_us = 0

    @property
    def pending(self) -> str:
        """Name of the unanswered request; empty when all are done."""
        return self._pending[0].name if self._pending else ""

    def due(self, t_us: int) -> bytes | None:
        """Return the frame to send now, if any."""
        if not self._pending or t_us < self._again_us:
            return None
        self._again_us = t_us + REPEAT_US
        return self._pending[0].raw

    def received(self, frame: Frame) -> None:
        """Check a frame from ArduPilot for the awaited answer."""
        if self._pending and self._pending[0].answered(frame):
            self._pending.pop(0)
            self._again_us = 0


def _read_back(name: str) -> SetupRequest:
    """Request a parameter, which must have the bridge's value.

    `answered` raises ConfigError if it has another.
    """

    def answered(frame: Frame) -> bool:
        if frame.layout.name != "PARAM_VALUE" or frame.read("param_id") != name.encode():
            return False
        value = frame.number("param_value")
        if value != REQUIRED_PARAMETERS[name]:
            raise ConfigError(
                f"{name}: ArduPilot has {value:g}, which does not use the bridge's sensors; "
                f"set it to {REQUIRED_PARAMETERS[name]:g}"
            )
        return True

    values = {"param_id": name.encode(), "param_index": -1, **TO_AUTOPILOT}
    raw = build_frame(PARAM_REQUEST_READ, values, component=COMPONENT)
    return SetupRequest(name, raw, answered)


def stream_requests() -> list[SetupRequest]:
    """Request a board's servo outputs and the streams that conditions and reports need."""
    return [
        _command(
            f"stream of {name}",
            SET_MESSAGE_INTERVAL,
            {"param1": float(message_layout(name).id), "param2": interval_us},
        )
        for name, interval_us in STREAM_INTERVALS_US.items()
    ]


def _command(name: str, number: int, parameters: dict[str, float]) -> SetupRequest:
    def answered(frame: Frame) -> bool:
        return (
            frame.layout.name == "COMMAND_ACK"
            and frame.number("command") == number
            and frame.number("result") == ACCEPTED
        )

    values = {"command": number, **TO_AUTOPILOT, **parameters}
    return SetupRequest(name, build_frame(COMMAND_LONG, values, component=COMPONENT), answered)
