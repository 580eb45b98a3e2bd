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
from typing import Literal

from fastcrc.crc16 import xmodem

from mavproxy_fault.ardupilot.hil_readings import HilImu
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

SYNC = b"\xfa"
FIX_3D = 3
INS_TRACKING = 0x0006  # INS status: mode 2 (tracking), GNSS fix
GPS_EPOCH_US = 2348 * 604_800_000_000  # 5 January 2025, as HIL_GPS has no date
SPEED_SIGMA_MPS = 0.3  # not in HIL_GPS; typical of a consumer receiver
RANGE_ERROR_M, WORST_DOP = 2.5, 99.0
HIL_GPS = message_layout("HIL_GPS")
NO_FIX = Frame(build_frame(HIL_GPS, {"eph": 0xFFFF, "epv": 0xFFFF}), HIL_GPS)

Values = Mapping[str, Sequence[float]]
Pace = Literal["imu", "gnss", "estimate"]

# Groups by bit number in the first byte, fields by bit number in the group's word.
COMMON, TIME, IMU, GNSS1, ATTITUDE, INS, GNSS2 = range(7)
_GNSS_FIELDS = {
    3: "satellites", 4: "fix", 5: "fix_lla", 7: "fix_velocity", 9: "fix_sigma",
    10: "velocity_sigma", 13: "dop",
}  # fmt: skip
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


def imu_values(imu: HilImu, t_us: int) -> dict[str, Sequence[float]]:
    """Return IMU, compass, barometer and time, by field name."""
    gyro, accel, field = imu.gyro_b_rps, imu.accel_b_mps2, imu.field_b_gauss
    temperature, pressure = imu.temperature_c, imu.pressure_pa * 1e-3
    return {
        "startup": (t_us * 1000,),
        "gps_time": ((GPS_EPOCH_US + t_us) * 1000,),
        "gyro": gyro,
        "accel": accel,
        "raw_imu": (*accel, *gyro),
        "field": field,
        "temperature": (temperature,),
        "pressure": (pressure,),
        "mag_pressure": (*field, temperature, pressure),
    }


def gnss_values(fix: Frame) -> dict[str, Sequence[float]]:
    """Return the solution in a HIL_GPS and the sensor's own estimate: level, at the last fix.

    Its eph and epv are errors in centimetres. ArduPilot uses the estimate only as a health check.
    Its attitude is not the true one, because no value may reach the estimator without passing the
    faults.
    """
    read = fix.number
    horizontal_m, vertical_m = read("eph") * 0.01, read("epv") * 0.01
    return {
        "satellites": (read("satellites_visible"),),
        "fix": (min(read("fix_type"), FIX_3D),),
        "fix_lla": (read("lat") * 1e-7, read("lon") * 1e-7, read("alt") * 1e-3),
        "fix_velocity": (read("vn") * 0.01, read("ve") * 0.01, read("vd") * 0.01),
        "fix_sigma": (horizontal_m, horizontal_m, vertical_m),
        "velocity_sigma": (SPEED_SIGMA_MPS,),
        "dop": (dilution(horizontal_m),) * 7,
        "ins_status": (INS_TRACKING if read("fix_type") else 0,),
        "ins_sigma": (horizontal_m,),
        "ypr": (0.0, 0.0, 0.0),
        "quaternion": (0.0, 0.0, 0.0, 1.0),  # x, y, z, w
        "ypr_sigma": (1.0, 1.0, 1.0),
    }


def dilution(error_m: float) -> float:
    """Return the dilution of precision of a position error, for a range error of 2.5 m."""
    return min(error_m / RANGE_ERROR_M, WORST_DOP)
