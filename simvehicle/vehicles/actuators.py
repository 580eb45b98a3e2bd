"""HIL_ACTUATOR_CONTROLS -> Controls: which PX4 channel drives which actuator.

PX4 numbers the outputs by airframe: `none_iris` and the generic hexa for multirotors, the plane
(1030) for fixed wings [1]_. A positive surface channel deflects the trailing edge up or to the
right; Controls follow Beard and McLain, where elevator down and rudder left are positive.

References
----------
.. [1] PX4, `ROMFS/px4fmu_common/init.d-posix/airframes`, and the user guide's "Control Surfaces".
"""

import math
import struct
from collections.abc import Callable, Sequence

import numpy as np

from mavproxy_fault.wire.frame import Frame
from simvehicle.vehicles.body import Controls, Vector

ARMED_FLAG = 128  # MAV_MODE_FLAG_SAFETY_ARMED in HIL_ACTUATOR_CONTROLS.mode
CHANNEL_COUNT = 16
# PX4's channels, from 0.
RUDDER, THROTTLE, LEFT_AILERON, RIGHT_AILERON, ELEVATOR = 2, 4, 5, 6, 7

Mix = Callable[[Sequence[float]], Vector]
_PAYLOAD = struct.Struct("<QQ16fB")


def motor_mix(count: int) -> Mix:
    """A mixer that maps the first `count` channels to the motors, in PX4's order."""

    def mix(channels: Sequence[float]) -> Vector:
        return np.array([min(max(value, 0.0), 1.0) for value in channels[:count]])

    return mix


def plane_mix(channels: Sequence[float]) -> Vector:
    """Map channels to elevator, aileron, rudder (-1 to 1) and throttle (0 to 1)."""
    # PX4's surface signs are opposite to Beard and McLain's; see the module docstring.
    return np.array(
        [
            -_limited(channels[ELEVATOR], -1.0),
            0.5
            * (_limited(channels[RIGHT_AILERON], -1.0) - _limited(channels[LEFT_AILERON], -1.0)),
            -_limited(channels[RUDDER], -1.0),
            _limited(channels[THROTTLE], 0.0),
        ]
    )


def read_controls(frame: Frame, mix: Mix) -> tuple[int, Controls]:
    """The HIL_SENSOR timestamp [us] that a HIL_ACTUATOR_CONTROLS answers, and its controls.

    A channel that is not finite means that the actuator is off, and counts as 0.
    """
    if frame.length == _PAYLOAD.size:
        stamp_us, _, *channels, mode = _PAYLOAD.unpack_from(frame.raw, frame.payload_at)
    else:
        stamp_us, _, *channels, mode = _PAYLOAD.unpack(frame.payload.ljust(_PAYLOAD.size, b"\0"))
    # One test for all channels is faster: almost all are finite.
    if not math.isfinite(sum(channels)):
        channels = [value if math.isfinite(value) else 0.0 for value in channels]
    return stamp_us, Controls(mix(channels), armed=bool(mode & ARMED_FLAG))


def _limited(value: float, low: float) -> float:
    return min(max(value, low), 1.0)
