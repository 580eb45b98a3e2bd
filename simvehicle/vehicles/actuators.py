"""HIL_ACTUATOR_CONTROLS -> Controls: which PX4 channel drives which actuator.

PX4 numbers the outputs by airframe: `none_iris` and the generic hexa for multirotors, the plane
(1030) for fixed wings [1]_. A positive surface channel deflects the trailing edge up or to the
right; Controls follow Beard and McLain, where elevator down and rudder left are positive.

References
----------
.. [1] PX4, `ROMFS/px4fmu_common/init.d-posix/airframes`, and the user guide's "Control Surfaces".
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.wire.frame import Frame
from simvehicle.vehicles.body import Controls

ARMED_FLAG = 128  # MAV_MODE_FLAG_SAFETY_ARMED in HIL_ACTUATOR_CONTROLS.mode
CHANNEL_COUNT = 16
# PX4's channels, from 0.
RUDDER, THROTTLE, LEFT_AILERON, RIGHT_AILERON, ELEVATOR = 2, 4, 5, 6, 7
# Places in the payload of HIL_ACTUATOR_CONTROLS, and its size
STAMP, CHANNELS, MODE, PAYLOAD_SIZE = 0, 16, 80, 81

Mix = Callable[[Sequence[float]], Array]


def motor_mix(count: int) -> Mix:
    """A mixer that maps the first `count` channels to the motors, in PX4's order."""
    return lambda channels: _mixed(channels, np.empty(count), wing=0)


def plane_mix(channels: Sequence[float]) -> Array:
    """Map channels to elevator, aileron, rudder (-1 to 1) and throttle (0 to 1)."""
    return _mixed(channels, np.empty(4), wing=1)


def _mixed(channels: Sequence[float], out: Array, wing: int) -> Array:
    mix_channels(np.asarray(channels, dtype=np.float64), wing, out)
    return out


@inlined
def _limited(value: float, low: float) -> float:
    return min(max(value, low), 1.0)


@compiled
def mix_channels(channels: Array, wing: int, out: Array) -> None:
    """Actuator commands (n,) of PX4's channels (16,): those of a fixed wing, or motors."""
    if wing:
        # PX4's surface signs are opposite to Beard and McLain's; see the module docstring.
        right, left = channels[RIGHT_AILERON], channels[LEFT_AILERON]
        out[0] = -_limited(channels[ELEVATOR], -1.0)
        out[1] = 0.5 * (_limited(right, -1.0) - _limited(left, -1.0))
        out[2] = -_limited(channels[RUDDER], -1.0)
        out[3] = _limited(channels[THROTTLE], 0.0)
    else:
        for i in range(out.shape[0]):
            out[i] = _limited(channels[i], 0.0)


@compiled
def read_channels(payload: NDArray[np.uint8], out: Array) -> None:
    """The channels (16,) of HIL_ACTUATOR_CONTROLS; one that is not finite means off, and is 0."""
    channels = payload[CHANNELS : CHANNELS + 4 * CHANNEL_COUNT].view(np.float32)
    for i in range(CHANNEL_COUNT):
        out[i] = channels[i] if np.isfinite(channels[i]) else 0.0


def read_controls(frame: Frame, mix: Mix) -> tuple[int, Controls]:
    """The HIL_SENSOR timestamp [us] that a HIL_ACTUATOR_CONTROLS answers, and its controls."""
    payload = bytearray(frame.payload.ljust(PAYLOAD_SIZE, b"\0"))
    channels = np.empty(CHANNEL_COUNT)
    read_channels(np.frombuffer(payload, dtype=np.uint8), channels)
    stamp_us = int.from_bytes(payload[STAMP : STAMP + 8], "little")
    return stamp_us, Controls(mix(channels.tolist()), armed=bool(payload[MODE] & ARMED_FLAG))
