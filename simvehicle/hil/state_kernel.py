"""The payload of HIL_STATE_QUATERNION, filled by one compiled call as it is sent at every step."""

import math

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3, STANDARD_GRAVITY_MPS2

Array = NDArray[np.float64]

MPS2_TO_MILLI_G = 1000.0 / STANDARD_GRAVITY_MPS2
RAD_TO_DEGE7 = 1e7 * 180.0 / math.pi
CM = 100.0
# Start of a payload's floats, positions and shorts, and its size, in bytes.
FLOATS, POSITIONS, SHORTS, PAYLOAD_SIZE = 8, 36, 48, 64
RATES = 4  # index in the floats, after the quaternion
INDICATED, TRUE_AIRSPEED, FORCE = 3, 4, 5  # indices in the shorts, after the velocity


class TruthPayload:
    """The bytes of one payload: time, then floats, positions and shorts [1]_.

    References
    ----------
    .. [1] MAVLink common message set, HIL_STATE_QUATERNION, fields in wire order.
    """

    def __init__(self) -> None:
        self.bytes = np.zeros(PAYLOAD_SIZE, dtype=np.uint8)
        self.stamp = self.bytes[:FLOATS].view(np.uint64)


@inlined
def _to_short(value: float) -> int:
    return int(min(max(np.rint(value), -32768.0), 32767.0))


@inlined
def _to_unsigned_short(value: float) -> int:
    """An unsigned short as the signed short with the same bits."""
    unsigned = int(min(max(np.rint(value), 0.0), 65535.0))
    return unsigned if unsigned < 32768 else unsigned - 65536


@compiled
def fill_truth_payload(
    q_nb: Array,
    omega_b_rps: Array,
    v_ned_mps: Array,
    force_b_mps2: Array,
    v_air_b_mps: Array,
    place: tuple[float, float, float, float],
    payload: NDArray[np.uint8],
) -> None:
    """Fill in the fields of a payload (64,) except its time.

    `place` is latitude and longitude [rad], height above mean sea level [m] and air density
    [kg/m^3]. Accelerations are the specific force in mG, as in other simulators (-1000 at rest);
    values outside a field's range saturate.
    """
    floats = payload[FLOATS:POSITIONS].view(np.float32)
    places = payload[POSITIONS:SHORTS].view(np.int32)
    shorts = payload[SHORTS:PAYLOAD_SIZE].view(np.int16)
    for i in range(4):
        floats[i] = q_nb[i]
    square = 0.0
    for i in range(3):
        floats[RATES + i] = omega_b_rps[i]
        shorts[i] = _to_short(v_ned_mps[i] * CM)
        shorts[FORCE + i] = _to_short(force_b_mps2[i] * MPS2_TO_MILLI_G)
        square += v_air_b_mps[i] * v_air_b_mps[i]
    lat, lon, alt, density = place
    places[0] = int(np.rint(lat * RAD_TO_DEGE7))
    places[1] = int(np.rint(lon * RAD_TO_DEGE7))
    places[2] = int(np.rint(alt * 1e3))
    airspeed = math.sqrt(square) * CM
    shorts[INDICATED] = _to_unsigned_short(airspeed * math.sqrt(density / SEA_LEVEL_DENSITY_KGPM3))
    shorts[TRUE_AIRSPEED] = _to_unsigned_short(airspeed)
