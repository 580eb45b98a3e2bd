"""Binary outputs of a VectorNav, with any of the fields that ArduPilot's drivers request; no I/O.

An output is a sync byte, a byte of group bits, one word of field bits per group, the payload, and a
CRC-16 (polynomial 0x1021, initial value 0) over everything after the sync byte, high byte first
[1]_. The driver writes its selection to registers 75 to 77 and compares the header of each packet
byte for byte. ArduPilot 4.6 requests IMU, estimate and GNSS separately, 4.5 IMU and estimate
together.

References
----------
.. [1] VectorNav, "VN-200 User Manual", UM004, binary output messages.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

from fastcrc.crc16 import xmodem

from mavproxy_fault.documents.errors import ConfigError

SYNC = b"\xfa"
FIX_3D = 3
INS_TRACKING = 0x0006  # INS status: mode 2 (tracking), GNSS fix
NO_FIX_SIGMA_M = 1e3

Values = Mapping[str, Sequence[float]]
Pace = Literal["imu", "gnss", "estimate"]

# Groups by bit number in the first byte, fields by bit number in the group's word.
COMMON, TIME, IMU, GNSS1, ATTITUDE, INS, GNSS2 = range(7)
_GNSS_FIELDS = {
    3: "satellites",
    4: "fix",
    5: "fix_lla",
    7: "fix_velocity",
    9: "fix_sigma",
    10: "velocity_sigma",
    13: "dop",
}
_FIELDS: dict[int, dict[int, str]] = {
    COMMON: {0: "startup", 1: "gps_time", 5: "gyro", 8: "accel", 9: "raw_imu", 10: "mag_pressure"},
    TIME: {0: "startup", 1: "gps_time"},
    # Uncompensated values equal the compensated ones.
    IMU: {
        1: "field", 2: "accel", 3: "gyro", 4: "temperature", 5: "pressure",
        8: "field", 9: "accel", 10: "gyro",
    },
    GNSS1: _GNSS_FIELDS,
    ATTITUDE: {1: "ypr", 2: "quaternion", 8: "ypr_sigma"},
    INS: {0: "ins_status", 1: "fix_lla", 4: "fix_velocity", 9: "ins_sigma", 10: "velocity_sigma"},
    # The second receiver repeats the first one.
    GNSS2: _GNSS_FIELDS,
}  # fmt: skip
_CODES = {
    "startup": "Q", "gps_time": "Q", "gyro": "3f", "accel": "3f", "raw_imu": "6f",
    "mag_pressure": "5f", "field": "3f", "temperature": "f", "pressure": "f", "satellites": "B",
    "fix": "B", "fix_lla": "3d", "fix_velocity": "3f", "fix_sigma": "3f", "velocity_sigma": "f",
    "dop": "7f", "ypr": "3f", "quaternion": "4f", "ypr_sigma": "3f", "ins_status": "H",
    "ins_sigma": "f",
}  # fmt: skip


class ImuOutput(NamedTuple):
    """Values of an IMU sample."""

    t_us: int
    gyro_b_rps: Sequence[float]
    accel_b_mps2: Sequence[float]
    field_b_gauss: Sequence[float]
    temperature_c: float
    pressure_pa: float


class GnssOutput(NamedTuple):
    """Values of a GNSS fix."""

    satellites: int
    fix: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    v_ned_mps: tuple[float, float, float]
    sigma_ned_m: tuple[float, float, float]
    sigma_v_mps: float
    dop: float


NO_FIX = GnssOutput(
    0, 0, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), (NO_FIX_SIGMA_M,) * 3, NO_FIX_SIGMA_M, 99.0
)


class BinaryOutput:
    """One output as a register configures it.

    Parameters
    ----------
    groups : int
        Bit mask of groups.
    field_words : sequence of int
        For each group, in order, a bit mask of fields.

    Attributes
    ----------
    pace : {"imu", "gnss", "estimate"}
        What triggers a packet: each IMU sample, each fix, or the estimate's period.

    Raises
    ------
    ConfigError
        If it has a field that is not supported.
    """

    def __init__(self, groups: int, field_words: Sequence[int]) -> None:
        chosen = [group for group in range(8) if groups >> group & 1]
        if len(chosen) != len(field_words):
            raise ConfigError(
                f"VectorNav: {len(field_words)} as the number of field words does not fit groups "
                f"{groups:#04x}; an output needs one for each group"
            )
        self._names = [
            _name(group, bit)
            for group, word in zip(chosen, field_words, strict=True)
            for bit in range(16)
            if word >> bit & 1
        ]
        self._payload = struct.Struct("<" + "".join(_CODES[name] for name in self._names))
        self._head = struct.pack(f"<B{len(field_words)}H", groups, *field_words)
        self.pace: Pace = "estimate"
        if not {"gyro", "accel"}.isdisjoint(self._names):
            self.pace = "imu"
        elif GNSS1 in chosen or GNSS2 in chosen:
            self.pace = "gnss"

    def packet(self, values: Values) -> bytes:
        """Encode one packet from the values of `imu_values` and `gnss_values`."""
        numbers = [number for name in self._names for number in values[name]]
        body = self._head + self._payload.pack(*numbers)
        return SYNC + body + xmodem(body).to_bytes(2, "big")


def _name(group: int, bit: int) -> str:
    name = _FIELDS.get(group, {}).get(bit)
    if name is None:
        raise ConfigError(
            f"VectorNav: the requested field {bit} of group {group + 1} is not supported; "
            "use ArduPilot 4.5 to 4.7"
        )
    return name


def imu_values(imu: ImuOutput, gps_epoch_us: int) -> dict[str, Sequence[float]]:
    """Return IMU, compass, barometer and time, by field name."""
    gyro, accel, field = imu.gyro_b_rps, imu.accel_b_mps2, imu.field_b_gauss
    temperature, pressure = imu.temperature_c, imu.pressure_pa * 1e-3
    return {
        "startup": (imu.t_us * 1000,),
        "gps_time": ((gps_epoch_us + imu.t_us) * 1000,),
        "gyro": gyro,
        "accel": accel,
        "raw_imu": (*accel, *gyro),
        "field": field,
        "temperature": (temperature,),
        "pressure": (pressure,),
        "mag_pressure": (*field, temperature, pressure),
    }


def gnss_values(gnss: GnssOutput) -> dict[str, Sequence[float]]:
    """Return a receiver's solution and the sensor's own estimate: level, at the last fix.

    ArduPilot uses the estimate only as a health check. Its attitude is not the true one, because
    no value may reach the estimator without passing the faults.
    """
    return {
        "satellites": (gnss.satellites,),
        "fix": (min(gnss.fix, FIX_3D),),
        "fix_lla": (gnss.lat_deg, gnss.lon_deg, gnss.alt_m),
        "fix_velocity": gnss.v_ned_mps,
        "fix_sigma": gnss.sigma_ned_m,
        "velocity_sigma": (gnss.sigma_v_mps,),
        "dop": (gnss.dop,) * 7,
        "ins_status": (INS_TRACKING if gnss.fix else 0,),
        "ins_sigma": (gnss.sigma_ned_m[0],),
        "ypr": (0.0, 0.0, 0.0),
        "quaternion": (0.0, 0.0, 0.0, 1.0),  # x, y, z, w
        "ypr_sigma": (1.0, 1.0, 1.0),
    }
