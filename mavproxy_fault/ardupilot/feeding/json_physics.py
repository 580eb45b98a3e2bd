"""Protocol of SITL's JSON backend: servo packets in, one line of JSON out per step; no I/O.

ArduPilot sends its outputs and waits for the line. It searches for the keys as substrings, so the
text must be compact and in this order [1]_.

References
----------
.. [1] ArduPilot, `libraries/SITL/examples/JSON/readme.md`.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from mavproxy_fault.ardupilot.hil_readings import HilImu, TrueState

MAGIC_16, MAGIC_32 = 18458, 29569  # packets of 16 and of 32 outputs
_HEAD = struct.Struct("<HHI")
_PWM = {MAGIC_16: struct.Struct("<16H"), MAGIC_32: struct.Struct("<32H")}


class ServoPacket(NamedTuple):
    """Servo outputs of ArduPilot; `accepted` counts the lines it has accepted since its start."""

    accepted: int
    pwm_us: tuple[int, ...]  # 16 or 32


def read_servos(data: bytes) -> ServoPacket | None:
    """Decode a servo packet; None if the bytes are not one."""
    if len(data) < _HEAD.size:
        return None
    magic, _, count = _HEAD.unpack_from(data)  # in between, the requested rate of lines
    pwm = _PWM.get(magic)
    if pwm is None or len(data) != _HEAD.size + pwm.size:
        return None
    return ServoPacket(count, pwm.unpack_from(data, _HEAD.size))


def state_line(
    truth: TrueState, imu: HilImu, r_ned_m: Sequence[float], airspeed_mps: float | None = None
) -> bytes:
    """Encode the line of one step; ArduPilot requires a line break on either side.

    The IMU and the true airspeed are measured; the rest is the simulator's truth, with the position
    from ArduPilot's `--home`.
    """
    text = (
        f'\n{{"timestamp":{truth.t_us / 1e6:.6f},'
        f'"imu":{{"gyro":{_vector(imu.gyro_b_rps)},"accel_body":{_vector(imu.accel_b_mps2)}}},'
        f'"position":{_vector(r_ned_m)},"quaternion":{_vector(truth.q_nb)},'
        f'"velocity":{_vector(truth.v_ned_mps)}'
    )
    if airspeed_mps is not None:
        text += f',"airspeed":{airspeed_mps:.6g}'
    return (text + "}\n").encode()


def _vector(values: Sequence[float]) -> str:
    # Nine digits preserve every float32.
    return "[" + ",".join([f"{value:.9g}" for value in values]) + "]"
