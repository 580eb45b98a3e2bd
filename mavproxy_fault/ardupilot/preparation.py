"""What ArduPilot is asked before anybody flies: is it set up right, and the calibrations; no I/O.

Devices that SITL has never seen must be calibrated before arming. Both calibrations are for a
vehicle at rest: the simple one of the accelerometer, and the compass' from a known heading.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mavproxy_fault.ardupilot.hil_readings import TrueState
from mavproxy_fault.ardupilot.outputs import COMPONENT
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

COMMAND_LONG, PARAM_REQUEST_READ = (
    message_layout("COMMAND_LONG"),
    message_layout("PARAM_REQUEST_READ"),
)
PREFLIGHT_CALIBRATION, SET_MESSAGE_INTERVAL, FIXED_MAG_CAL_YAW = 241, 511, 42006  # MAV_CMD_
STREAM_INTERVALS_US = {  # of a board, which tells nothing by itself: 6 kB/s
    "SERVO_OUTPUT_RAW": 10_000.0,
    "GLOBAL_POSITION_INT": 200_000.0,
    "ATTITUDE": 100_000.0,
    "EKF_STATUS_REPORT": 500_000.0,
}
SIMPLE_ACCEL = 4.0  # PREFLIGHT_CALIBRATION.param5
ACCEPTED = 0  # MAV_RESULT_
REPEAT_US = 1_000_000

REQUIRED_PARAMETERS = {"AHRS_EKF_TYPE": 3.0, "EAHRS_TYPE": 1.0}


@dataclass(frozen=True, slots=True)
class SetupRequest:
    """One frame to ArduPilot, and how its answer is known."""

    name: str
    raw: bytes
    answered: Callable[[Frame], bool]


class Preparation:
    """Requests one after the other, each repeated until it is answered.

    Parameters
    ----------
    at_rest : TrueState
        Where the vehicle stands and which way it points.
    first : sequence of Request
        What is asked before all.
    """

    def __init__(self, at_rest: TrueState, first: Sequence[SetupRequest] = ()) -> None:
        self._pending = [
            *first,
            *map(_read_back, REQUIRED_PARAMETERS),
            _accelerometer(),
            _compass(at_rest),
        ]
        self._again_us = 0

    @property
    def pending(self) -> str:
        """What is waited for; empty when all is done."""
        return self._pending[0].name if self._pending else ""

    def due(self, t_us: int) -> bytes | None:
        """The frame to send now, if any."""
        if not self._pending or t_us < self._again_us:
            return None
        self._again_us = t_us + REPEAT_US
        return self._pending[0].raw

    def received(self, frame: Frame) -> None:
        """Read what ArduPilot says."""
        if self._pending and self._pending[0].answered(frame):
            self._pending.pop(0)
            self._again_us = 0


def _read_back(name: str) -> SetupRequest:
    """ArduPilot's value of a parameter, which must be the bridge's.

    The answer raises ConfigError where it is another.
    """

    def answered(frame: Frame) -> bool:
        if frame.layout.name != "PARAM_VALUE" or frame.read("param_id") != name.encode():
            return False
        value = frame.number("param_value")
        if value != REQUIRED_PARAMETERS[name]:
            raise ConfigError(
                f"{name}: ArduPilot flies with {value:g}, which does not fly on the bridge's "
                f"sensors; it must be {REQUIRED_PARAMETERS[name]:g}"
            )
        return True

    values = {
        "param_id": name.encode(),
        "param_index": -1,
        "target_system": 1,
        "target_component": 1,
    }
    return SetupRequest(
        name, build_frame(PARAM_REQUEST_READ, values, component=COMPONENT), answered
    )


def stream_requests() -> list[SetupRequest]:
    """Outputs, which a board has no other way to tell, and what conditions and reports look at."""
    return [
        _command(
            f"stream of {name}",
            SET_MESSAGE_INTERVAL,
            {"param1": float(message_layout(name).id), "param2": interval_us},
        )
        for name, interval_us in STREAM_INTERVALS_US.items()
    ]


def _accelerometer() -> SetupRequest:
    values = {"param5": SIMPLE_ACCEL}
    return _command("accelerometer calibration", PREFLIGHT_CALIBRATION, values)


def _compass(at_rest: TrueState) -> SetupRequest:
    values = {
        "param1": at_rest.yaw_deg,
        "param3": at_rest.lat_e7 * 1e-7,
        "param4": at_rest.lon_e7 * 1e-7,
    }
    return _command("compass calibration", FIXED_MAG_CAL_YAW, values)


def _command(name: str, number: int, parameters: dict[str, float]) -> SetupRequest:
    def answered(frame: Frame) -> bool:
        return (
            frame.layout.name == "COMMAND_ACK"
            and frame.number("command") == number
            and frame.number("result") == ACCEPTED
        )

    values = {"command": number, "target_system": 1, "target_component": 1, **parameters}
    return SetupRequest(name, build_frame(COMMAND_LONG, values, component=COMPONENT), answered)
