"""A VectorNav VN-200 in bytes: the three binary outputs that ArduPilot's driver asks for; no I/O.

Binary outputs are a sync byte, the groups and fields chosen, the payload, and a CRC-16 (polynomial
0x1021, start 0) over all after the sync byte, high byte first [1]_. The groups and fields here are
those that the driver sets and compares byte for byte.

References
----------
.. [1] VectorNav, "VN-200 User Manual", UM004, binary output messages.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from fastcrc.crc16 import xmodem

SYNC = b"\xfa"
IMU_HEAD = bytes.fromhex("01 21 07")
GNSS_HEAD = bytes.fromhex("49 03 00 B8 26 18 00")
INS_HEAD = bytes.fromhex("31 01 00 06 01 13 06")
FIX_3D = 3
INS_TRACKING = 0x0006  # INS status: mode 2 (tracking), GNSS fix

_IMU = struct.Struct("<Q17f")
_GNSS = struct.Struct("<QQBB3d3f3ff7fBB")
_INS = struct.Struct("<Q3f4f3fH3d3fff")


class ImuOutput(NamedTuple):
    """What one IMU packet holds."""

    t_us: int
    gyro_b_rps: Sequence[float]
    accel_b_mps2: Sequence[float]
    field_b_gauss: Sequence[float]
    temperature_c: float
    pressure_pa: float


class GnssOutput(NamedTuple):
    """What one GNSS packet holds."""

    t_us: int
    gps_time_us: int  # since 6 January 1980
    satellites: int
    fix: int
    lat_deg: float
    lon_deg: float
    alt_m: float
    v_ned_mps: tuple[float, float, float]
    sigma_ned_m: tuple[float, float, float]
    sigma_v_mps: float
    dop: float


def imu_packet(imu: ImuOutput) -> bytes:
    """IMU, compass and barometer; the uncompensated values equal the compensated ones."""
    gyro, accel = imu.gyro_b_rps, imu.accel_b_mps2
    return _packet(
        IMU_HEAD,
        _IMU.pack(
            imu.t_us * 1000,
            *gyro,
            *accel,
            *accel,
            *gyro,
            *imu.field_b_gauss,
            imu.temperature_c,
            imu.pressure_pa * 1e-3,
        ),
    )


def gnss_packet(gnss: GnssOutput) -> bytes:
    """A receiver's solution; the VN-200's second receiver is the first one again."""
    fix = min(gnss.fix, FIX_3D)
    return _packet(
        GNSS_HEAD,
        _GNSS.pack(
            gnss.t_us * 1000,
            gnss.gps_time_us * 1000,
            gnss.satellites,
            fix,
            gnss.lat_deg,
            gnss.lon_deg,
            gnss.alt_m,
            *gnss.v_ned_mps,
            *gnss.sigma_ned_m,
            gnss.sigma_v_mps,
            *(gnss.dop,) * 7,
            gnss.satellites,
            fix,
        ),
    )


def ins_packet(gnss: GnssOutput, t_us: int) -> bytes:
    """The sensor's own estimate, which ArduPilot asks for health alone: level, at the last fix.

    The attitude is not the truth's: nothing may reach the estimator past the faults.
    """
    return _packet(
        INS_HEAD,
        _INS.pack(
            t_us * 1000,
            *(0.0, 0.0, 0.0),
            *(0.0, 0.0, 0.0, 1.0),  # x, y, z, w
            *(1.0, 1.0, 1.0),
            INS_TRACKING,
            gnss.lat_deg,
            gnss.lon_deg,
            gnss.alt_m,
            *gnss.v_ned_mps,
            gnss.sigma_ned_m[0],
            gnss.sigma_v_mps,
        ),
    )


def _packet(head: bytes, payload: bytes) -> bytes:
    body = head + payload
    return SYNC + body + xmodem(body).to_bytes(2, "big")
