"""SITL's JSON backend in bytes: servo packets in, one line of text out per step; no I/O.

ArduPilot sends its outputs and waits for the line. It looks for the keys as substrings, so that the
text must be compact and in this order [1]_.

References
----------
.. [1] ArduPilot, `libraries/SITL/examples/JSON/readme.md`.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

MAGIC_16, MAGIC_32 = 18458, 29569  # of 16 and of 32 outputs
_HEAD = struct.Struct("<HHI")
_PWM = {MAGIC_16: struct.Struct("<16H"), MAGIC_32: struct.Struct("<32H")}


class ServoPacket(NamedTuple):
    """One answer of ArduPilot: `accepted` is how many lines it has accepted since it started."""

    rate_hz: int  # at which it would like lines
    accepted: int
    pwm_us: tuple[int, ...]  # 16 or 32


class BodyState(NamedTuple):
    """What a line tells: `gyro` and `accel` are measured, the rest is the simulator's truth."""

    t_us: int
    gyro_b_rps: Sequence[float]
    accel_b_mps2: Sequence[float]
    r_ned_m: Sequence[float]  # from ArduPilot's --home
    q_nb: Sequence[float]
    v_ned_mps: Sequence[float]
    airspeed_mps: float | None = None  # true airspeed
    battery_va: Sequence[float] | None = None  # V and A, which early versions do not read


def read_servos(data: bytes) -> ServoPacket | None:
    """A servo packet; None where the bytes are none."""
    if len(data) < _HEAD.size:
        return None
    magic, rate_hz, count = _HEAD.unpack_from(data)
    pwm = _PWM.get(magic)
    if pwm is None or len(data) != _HEAD.size + pwm.size:
        return None
    return ServoPacket(rate_hz, count, pwm.unpack_from(data, _HEAD.size))


def state_line(state: BodyState) -> bytes:
    """The line for one step; ArduPilot wants a line break on either side."""
    text = (
        f'\n{{"timestamp":{state.t_us / 1e6:.6f},'
        f'"imu":{{"gyro":{_vector(state.gyro_b_rps)},"accel_body":{_vector(state.accel_b_mps2)}}},'
        f'"position":{_vector(state.r_ned_m)},"quaternion":{_vector(state.q_nb)},'
        f'"velocity":{_vector(state.v_ned_mps)}'
    )
    if state.airspeed_mps is not None:
        text += f',"airspeed":{state.airspeed_mps:.6g}'
    if state.battery_va is not None:
        voltage_v, current_a = state.battery_va
        text += f',"battery":{{"voltage":{voltage_v:.6g},"current":{current_a:.6g}}}'
    return (text + "}\n").encode()


def _vector(values: Sequence[float]) -> str:
    # Nine digits carry every float32 unchanged.
    return "[" + ",".join([f"{value:.9g}" for value in values]) + "]"
