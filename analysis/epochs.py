"""MAVLink frames and RINEX files -> samples, the one form everything else works on.

HIL_SENSOR carries what `fields_updated` says: bits 0 to 5 acceleration and rates, 6 to 8 the
magnetic field, 9 static pressure, 10 differential pressure, 11 the altitude made of it [1]_.

References
----------
.. [1] MAVLink common message set, HIL_SENSOR_UPDATED_FLAGS.
"""

import math
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from statistics import median_low

import numpy as np

from analysis.samples import (
    AirspeedSample,
    AttitudeSample,
    BaroSample,
    EphemerisSample,
    Epoch,
    GpsFix,
    ImuSample,
    IonosphereSample,
    MagSample,
    RangeSample,
    Sample,
    TruthSample,
    Vector,
    VisionSample,
)
from mavproxy_fault.wire.dialect import known
from mavproxy_fault.wire.ephemeris import decode_ephemeris
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.msm7 import Msm7, decode_msm7
from mavproxy_fault.wire.rtcm import Reassembler, message_number, tunnel_payload
from simvehicle.rotation import matrix_from_quat, quat_from_euler

__all__ = [
    "AirspeedSample",
    "AttitudeSample",
    "BaroSample",
    "Decoder",
    "EphemerisSample",
    "Epoch",
    "GpsFix",
    "ImuSample",
    "IonosphereSample",
    "MagSample",
    "RangeSample",
    "Sample",
    "TruthSample",
    "Vector",
    "VisionSample",
    "read_rinex_samples",
]

IMU_BITS = 0x3F
MAG_BITS = 0x1C0
BARO_BIT = 0x200
AIRSPEED_BIT = 0x400
HECTOPASCAL = 100.0
STANDARD_GRAVITY = 9.80665  # m/s^2, CODATA
DOWNWARD = 25  # MAV_SENSOR_ROTATION_PITCH_270
BODY_FRD = 12  # MAV_FRAME_BODY_FRD
UNKNOWN_16 = 0xFFFF
HALF_WEEK_S = 302_400.0
WEEK_S = 604_800
OFFSETS_KEPT = 25
UNIX_TO_GPS_S = 315_964_800  # 1980-01-06 on Unix's count


@lru_cache(maxsize=32)
def _packing(number: int) -> tuple[struct.Struct, int]:
    layout = known(number)
    code = "".join(f"{max(f.count, 1)}{f.code}" for f in layout.fields.values())
    return struct.Struct("<" + code), layout.length


def _unpack(frame: Frame) -> tuple[float, ...]:
    """All numbers of a frame in the order of the wire; cut zeros read as 0."""
    packing, length = _packing(frame.id)
    return packing.unpack(frame.payload.ljust(length, b"\0"))


class Decoder:
    """Frames of one stream to samples; holds what spans frames (RTCM fragments, clock offset).

    TUNNEL frames bear no stamp, so a pseudorange epoch gets its GPS time plus the median
    of the newest differences between the sender's clock and GPS time: a late frame keeps its true
    time, and so do the frames of a sender whose stamped messages pause.
    """

    __slots__ = ("_offsets", "_parts", "_reassemblers", "_stamps", "_week")

    def __init__(self) -> None:
        self._reassemblers: dict[tuple[int, int], Reassembler] = {}
        self._stamps: dict[tuple[int, int], int] = {}
        self._offsets: deque[int] = deque(maxlen=OFFSETS_KEPT)
        self._parts: list[Msm7] = []
        self._week: tuple[int, float] | None = None

    def decode(self, frame: Frame) -> list[Sample]:
        """The samples one frame holds; none for messages that carry no measurement."""
        name = frame.layout.name
        if name == "TUNNEL":
            return self._tunnel(frame)
        read = _READERS.get(name)
        if read is None:
            return []
        samples = read(frame)
        if samples and name in ("HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION"):
            self._stamps[frame.system, frame.component] = samples[-1].t_us
        return samples

    def _tunnel(self, frame: Frame) -> list[Sample]:
        payload = tunnel_payload(frame)
        if payload is None:
            return []
        sender = frame.system, frame.component
        samples: list[Sample] = []
        for message in self._reassemblers.setdefault(sender, Reassembler()).add(payload):
            samples += self._rtcm(message, self._stamps.get(sender))
        return samples

    def _rtcm(self, message: bytes, stamp_us: int | None) -> list[Sample]:
        number = message_number(message)
        try:
            if number in (1019, 1046):
                ephemeris = decode_ephemeris(message)
                self._week = ephemeris.week, ephemeris.toe_s
                return [EphemerisSample(stamp_us or 0, ephemeris)]
            if number in (1077, 1097):
                return self._ranges(decode_msm7(message), stamp_us)
        except ValueError:  # a peer's bad bytes are no sample
            return []
        return []

    def _ranges(self, part: Msm7, stamp_us: int | None) -> list[Sample]:
        """Collect the messages of one epoch; the epoch when its last one is here."""
        done: list[Sample] = []
        if self._parts and self._parts[0].tow_s != part.tow_s:
            done = self._epoch(stamp_us)
        self._parts.append(part)
        return done if part.more else done + self._epoch(stamp_us)

    def _epoch(self, stamp_us: int | None) -> list[Sample]:
        parts, self._parts = self._parts, []
        tow_s = parts[0].tow_s
        week = self._full_week(tow_s)
        gps_us = round((week * WEEK_S + tow_s) * 1e6)
        if stamp_us is not None:
            offset_us = stamp_us - gps_us
            if self._offsets and abs(offset_us - self._offsets[-1]) > WEEK_S * 1_000_000 // 2:
                self._offsets.clear()  # the week has become known
            self._offsets.append(offset_us)
        offset_us = median_low(self._offsets) if self._offsets else 0
        return [
            Epoch(
                t_us=gps_us + offset_us,
                week=week,
                tow_s=tow_s,
                satellites=tuple(name for part in parts for name in part.satellites),
                pseudorange_m=np.array([x for part in parts for x in part.pseudorange_m]),
                doppler_mps=np.array([x for part in parts for x in part.doppler_mps]),
                cn0_dbhz=np.array([x for part in parts for x in part.cn0_dbhz]),
            )
        ]

    def _full_week(self, tow_s: float) -> int:
        """MSM gives no week; the newest ephemeris does (0 before there is one)."""
        if self._week is None:
            return 0
        week, toe_s = self._week
        if tow_s - toe_s > HALF_WEEK_S:
            return week - 1
        return week + 1 if toe_s - tow_s > HALF_WEEK_S else week


def _hil_sensor(frame: Frame) -> list[Sample]:
    v = _unpack(frame)
    t_us, updated = int(v[0]), int(v[14])
    samples: list[Sample] = []
    if updated & IMU_BITS == IMU_BITS:
        samples.append(ImuSample(t_us, np.array(v[4:7]), np.array(v[1:4]), int(v[15])))
    if updated & MAG_BITS == MAG_BITS:
        samples.append(MagSample(t_us, np.array(v[7:10])))
    if updated & BARO_BIT:
        samples.append(BaroSample(t_us, HECTOPASCAL * v[10], v[12]))
    if updated & AIRSPEED_BIT:
        samples.append(AirspeedSample(t_us, HECTOPASCAL * v[11]))
    return samples


def _highres_imu(frame: Frame) -> list[Sample]:
    v = _unpack(frame)
    t_us, updated = int(v[0]), int(v[14])
    samples: list[Sample] = []
    if updated & IMU_BITS == IMU_BITS:
        samples.append(ImuSample(t_us, np.array(v[4:7]), np.array(v[1:4]), int(v[15])))
    if updated & MAG_BITS == MAG_BITS:
        samples.append(MagSample(t_us, np.array(v[7:10])))
    return samples


def _scaled_imu(frame: Frame) -> list[Sample]:
    v = _unpack(frame)
    accel = np.array(v[1:4]) * (STANDARD_GRAVITY * 1e-3)
    return [ImuSample(int(v[0]) * 1000, np.array(v[4:7]) * 1e-3, accel)]


def _accuracy(value: float) -> float:
    return value * 1e-2 if value != UNKNOWN_16 else math.nan


def _hil_gps(frame: Frame) -> list[Sample]:
    read = frame.number
    v_ned = np.array([read("vn"), read("ve"), read("vd")]) * 1e-2
    return [
        GpsFix(
            t_us=int(read("time_usec")),
            lat_deg=read("lat") * 1e-7,
            lon_deg=read("lon") * 1e-7,
            alt_m=read("alt") * 1e-3,
            v_ned_mps=v_ned,
            fix_type=int(read("fix_type")),
            satellites=int(read("satellites_visible")),
            eph_m=_accuracy(read("eph")),
            epv_m=_accuracy(read("epv")),
            source="HIL_GPS",
        )
    ]


def _gps_raw_int(frame: Frame) -> list[Sample]:
    read = frame.number
    v_ned = None
    if read("vel") != UNKNOWN_16 and read("cog") != UNKNOWN_16:
        course, speed = math.radians(read("cog") * 1e-2), read("vel") * 1e-2
        v_ned = np.array([speed * math.cos(course), speed * math.sin(course), math.nan])
    h_acc, v_acc = read("h_acc"), read("v_acc")
    return [
        GpsFix(
            t_us=int(read("time_usec")),
            lat_deg=read("lat") * 1e-7,
            lon_deg=read("lon") * 1e-7,
            alt_m=read("alt") * 1e-3,
            v_ned_mps=v_ned,
            fix_type=int(read("fix_type")),
            satellites=int(read("satellites_visible")),
            eph_m=h_acc * 1e-3 if h_acc else math.nan,
            epv_m=v_acc * 1e-3 if v_acc else math.nan,
            source="GPS_RAW_INT",
        )
    ]


def _hil_state(frame: Frame) -> list[Sample]:
    v = _unpack(frame)
    return [
        TruthSample(
            t_us=int(v[0]),
            q_nb=np.array(v[1:5]),
            omega_b_rps=np.array(v[5:8]),
            lat_deg=v[8] * 1e-7,
            lon_deg=v[9] * 1e-7,
            alt_m=v[10] * 1e-3,
            v_ned_mps=np.array(v[11:14]) * 1e-2,
        )
    ]


def _distance(frame: Frame) -> list[Sample]:
    read = frame.number
    distance = read("current_distance")
    inside = read("min_distance") <= distance <= read("max_distance")
    if read("orientation") != DOWNWARD or not inside:
        return []
    return [RangeSample(int(read("time_boot_ms")) * 1000, distance * 1e-2)]


def _odometry(frame: Frame) -> list[Sample]:
    v = _unpack(frame)
    q_nb, velocity = np.array(v[4:8]), np.array(v[8:11])
    norm = float(np.linalg.norm(q_nb))
    if not norm > 0.0:
        return []
    q_nb = q_nb / norm
    if frame.number("child_frame_id") == BODY_FRD:
        velocity = matrix_from_quat(q_nb) @ velocity
    return [
        VisionSample(
            int(v[0]), np.array(v[1:4]), velocity if np.isfinite(velocity).all() else None, q_nb
        )
    ]


def _vision(frame: Frame) -> list[Sample]:
    v = _unpack(frame)
    return [VisionSample(int(v[0]), np.array(v[1:4]), None, quat_from_euler(*v[4:7]))]


def _attitude(frame: Frame) -> list[Sample]:
    v = _unpack(frame)
    q_nb = quat_from_euler(v[1], v[2], v[3])
    return [AttitudeSample(int(v[0]) * 1000, q_nb, frame.system, frame.layout.name)]


def _attitude_quaternion(frame: Frame) -> list[Sample]:
    v = _unpack(frame)
    return [AttitudeSample(int(v[0]) * 1000, np.array(v[1:5]), frame.system, frame.layout.name)]


_READERS: dict[str, Callable[[Frame], list[Sample]]] = {
    "HIL_SENSOR": _hil_sensor,
    "HIGHRES_IMU": _highres_imu,
    "SCALED_IMU": _scaled_imu,
    "HIL_GPS": _hil_gps,
    "GPS_RAW_INT": _gps_raw_int,
    "HIL_STATE_QUATERNION": _hil_state,
    "DISTANCE_SENSOR": _distance,
    "ODOMETRY": _odometry,
    "VISION_POSITION_ESTIMATE": _vision,
    "ATTITUDE": _attitude,
    "ATTITUDE_QUATERNION": _attitude_quaternion,
}


def read_rinex_samples(
    observations: Path, navigation: Path, imu: Path | None = None
) -> list[Sample]:
    """A RINEX observation and navigation file, and IMU samples where there are any, by time.

    The IMU file has one sample a line: GPS time on Unix's count of seconds, specific force (3) in g
    and rates (3) in rad/s, axes forward-left-up; further columns are passed over. `t_us` counts
    from the start of GPS time; what the navigation file holds comes first, stamped as the first.

    Raises
    ------
    ConfigError
        If a file cannot be read as what it should be.
    """
    from analysis.rinex import read_observations
    from analysis.rinex_navigation import read_navigation

    epochs = read_observations(observations)
    samples: list[Sample] = list(epochs)
    if imu is not None:
        samples += _read_imu(imu)
    samples.sort(key=lambda sample: sample.t_us)
    first_us = samples[0].t_us if samples else 0
    known = [replace(sample, t_us=first_us) for sample in read_navigation(navigation)]
    return [*known, *samples]


def _read_imu(path: Path) -> list[ImuSample]:
    from mavproxy_fault.errors import ConfigError

    try:
        table = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: is no table of IMU samples ({error})") from error
    if table.shape[1] < 7:
        raise ConfigError(
            f"{path}: has {table.shape[1]} columns; time, force (3) and rates (3) are needed"
        )
    to_frd = np.array([1.0, -1.0, -1.0])
    stamps = np.rint((table[:, 0] - UNIX_TO_GPS_S) * 1e6).astype(np.int64)
    force = table[:, 1:4] * to_frd * STANDARD_GRAVITY
    rates = table[:, 4:7] * to_frd
    return [ImuSample(int(t), g, a) for t, g, a in zip(stamps, rates, force, strict=True)]
