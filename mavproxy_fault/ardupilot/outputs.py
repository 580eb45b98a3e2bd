"""Conversion of ArduPilot's servo outputs to HIL_ACTUATOR_CONTROLS in PX4's channel order; no I/O.

ArduPilot's quad X has the motor order of PX4's `none_iris`: front right, rear left, front left,
rear right. The first four outputs of a plane are aileron, elevator, throttle and rudder.
"""

from collections.abc import Sequence

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

HIL_ACTUATOR_CONTROLS = message_layout("HIL_ACTUATOR_CONTROLS")
CHANNELS = 16
COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER: ArduPilot itself is component 1
MODE_ENABLED, MODE_ARMED = 1, 128  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, _SAFETY_ARMED
FLAG_LOCKSTEP = 1
LOW_US, MIDDLE_US, SPAN_US = 1000, 1500, 1000
RUDDER, THROTTLE, LEFT_AILERON, RIGHT_AILERON, ELEVATOR = 2, 4, 5, 6, 7


def motor_channels(pwm_us: Sequence[int]) -> list[float]:
    """Convert every output as a motor: 0 at 1000 us, 1 at 2000 us."""
    return [throttle_fraction(pwm) for pwm in pwm_us[:CHANNELS]]


def plane_channels(pwm_us: Sequence[int]) -> list[float]:
    """Convert aileron, elevator, throttle and rudder to the channels of PX4's plane.

    Positive channels deflect a trailing edge up or to the right, as do ArduPilot's outputs above
    1500 us for elevator and rudder; its aileron above 1500 us rolls to the right.
    """
    roll, pitch, yaw = (surface_fraction(pwm_us[output]) for output in (0, 1, 3))
    channels = [0.0] * CHANNELS
    channels[RUDDER] = yaw
    channels[THROTTLE] = throttle_fraction(pwm_us[2])
    channels[LEFT_AILERON], channels[RIGHT_AILERON] = -roll, roll
    channels[ELEVATOR] = pitch
    return channels


def throttle_fraction(pwm_us: int) -> float:
    """Convert a pulse width to 0 to 1."""
    return min(max((pwm_us - LOW_US) / SPAN_US, 0.0), 1.0)


def surface_fraction(pwm_us: int) -> float:
    """Convert a pulse width to -1 to 1; an unused output (0 us) is centred."""
    return min(max((pwm_us - MIDDLE_US) / (SPAN_US / 2), -1.0), 1.0) if pwm_us else 0.0


def actuator_frame(
    stamp_us: int, channels: Sequence[float], seq: int, *, armed: bool, system: int = 1
) -> bytes:
    """Encode the HIL_ACTUATOR_CONTROLS that answers the step at `stamp_us`."""
    values = {
        "time_usec": stamp_us,
        "flags": FLAG_LOCKSTEP,
        "controls": channels,
        "mode": MODE_ENABLED | (MODE_ARMED if armed else 0),
    }
    return build_frame(HIL_ACTUATOR_CONTROLS, values, seq=seq, system=system, component=COMPONENT)
