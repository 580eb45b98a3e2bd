"""One flight of 60 s as a tlog, a dataflash log and a ULog, with stamps and a place to choose.

A copter takes off at 6 s, flies 58 m to the east at a height of 10 m, and lands at 54 s; from 25 to
35 s it vibrates too much. Layouts: MAVLink's common.xml, ArduPilot's log reference, PX4's ULog
specification and message definitions.
"""

from collections.abc import Callable, Iterator
from math import cos, degrees, radians
from struct import calcsize, pack
from typing import NamedTuple

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

HERE = (47.0, 8.0)
NOON_US, BOOT_US = 1_700_000_000_000_000, 90_000_000
EARTH_M = 6_371_000.0
TICKS, RATE_HZ = 600, 10
ARMED_S, AIR_S, SHAKEN_S = (4.0, 56.0), (6.0, 54.0), (25.0, 35.0)

Stamp = Callable[[int, int], int]  # of a time in us and the number of the message


def unmoved(t_us: int, number: int) -> int:
    """The time itself."""
    return t_us


class Instant(NamedTuple):
    """The vehicle at one tenth of a second."""

    tick: int
    t_s: float
    lat_deg: float
    lon_deg: float
    up_m: float
    climb_mps: float
    east_mps: float
    armed: bool
    flying: bool
    shaken: bool


def instants(place: tuple[float, float]) -> Iterator[Instant]:
    """The flight from a place (latitude, longitude in degrees), tick by tick."""
    for tick in range(TICKS):
        t_s = tick / RATE_HZ
        up_m = min(max(2.0 * (t_s - 6.0), 0.0), 10.0, max(54.0 - t_s, 0.0))
        climb = 2.0 if 6.0 < t_s < 11.0 else -1.0 if 44.0 < t_s < 54.0 else 0.0
        east_m = 2.0 * min(max(t_s - 11.0, 0.0), 29.0)
        lon = place[1] + degrees(east_m / EARTH_M) / cos(radians(place[0]))
        within = (a <= t_s < b for a, b in (ARMED_S, AIR_S, SHAKEN_S))
        yield Instant(
            tick, t_s, place[0], (lon + 180.0) % 360.0 - 180.0, up_m, climb,
            2.0 if 11.0 < t_s < 40.0 else 0.0, *within,
        )  # fmt: skip


def tlog(stamp: Stamp = unmoved, place: tuple[float, float] = HERE, stamped: bool = True) -> bytes:
    """The flight as a ground station records it; `stamp` moves the log's own timestamps."""
    found: list[bytes] = []

    def send(now: Instant, name: str, **values: object) -> None:
        number = len(found)
        raw = build_frame(message_layout(name), values, seq=number % 256, system=1, component=1)
        t_us = stamp(NOON_US + round(now.t_s * 1e6), number)
        found.append((pack(">Q", t_us) if stamped else b"") + raw)

    for now in instants(place):
        ms = BOOT_US // 1000 + now.tick * 100
        where = {"lat": round(now.lat_deg * 1e7), "lon": round(now.lon_deg * 1e7)}
        where["alt"] = 500_000 + round(now.up_m * 1e3)
        if now.tick % 10 == 0:
            base = 0x80 if now.armed else 0
            send(now, "HEARTBEAT", type=2, autopilot=3, base_mode=base, custom_mode=5)
            shaking = {"vibration_x": 90.0 if now.shaken else 5.0}
            send(now, "VIBRATION", time_usec=ms * 1000, **shaking)
        if now.tick % 2 == 0:
            fix = {"fix_type": 3, "satellites_visible": 12, "eph": 80, "vel": 0, **where}
            send(now, "GPS_RAW_INT", time_usec=ms * 1000, **fix)
        send(now, "ATTITUDE", time_boot_ms=ms, roll=0.01)
        motion = {"vx": 0, "vy": round(now.east_mps * 100), "vz": round(-now.climb_mps * 100)}
        height = {"relative_alt": round(now.up_m * 1e3)}
        send(now, "GLOBAL_POSITION_INT", time_boot_ms=ms, **where, **height, **motion)
    return b"".join(found)


# Type, name, format and columns; struct's form of ArduPilot's format characters.
FORMATS = (
    (0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns"),
    (129, "PARM", "QNff", "TimeUS,Name,Value,Default"), (130, "MSG", "QZ", "TimeUS,Message"),
    (131, "EV", "QB", "TimeUS,Id"), (132, "MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn"),
    (133, "ATT", "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    (134, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    (135, "GPS", "QBBIHBcLLefff", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ"),
    (136, "POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"),
    (137, "VIBE", "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip"),
    (138, "BAT", "QBfff", "TimeUS,Inst,Volt,VoltR,Curr"),
)  # fmt: skip
FORMS = {"n": "4s", "N": "16s", "Z": "64s", "c": "h", "L": "i", "e": "i", "M": "B"}
PACKED = {name: (number, "<" + "".join(FORMS.get(code, code) for code in codes))
          for number, name, codes, _ in FORMATS}  # fmt: skip


def dataflash(
    stamp: Stamp = unmoved, place: tuple[float, float] = HERE, stamped: bool = True
) -> bytes:
    """The flight as ArduPilot logs it; `stamp` moves TimeUS."""
    found: list[bytes] = []
    for number, name, codes, columns in FORMATS:
        length = 3 + calcsize(PACKED[name][1])
        if not stamped and name != "FMT":
            length, codes, columns = length - 8, codes[1:], columns.removeprefix("TimeUS,")
        words = (part.encode() for part in (name, codes, columns))
        found.append(b"\xa3\x95\x80" + pack("<BB4s16s64s", number, length, *words))

    def log(now: Instant, name: str, *values: object) -> None:
        number, form = PACKED[name]
        t_us = stamp(BOOT_US + round(now.t_s * 1e6), len(found))
        words = (value.encode() if isinstance(value, str) else value for value in values)
        row = pack(form, t_us % (1 << 64), *words)
        found.append(b"\xa3\x95" + bytes([number]) + (row if stamped else row[8:]))

    armed = False
    for now in instants(place):
        where = round(now.lat_deg * 1e7), round(now.lon_deg * 1e7)
        if now.tick == 0:
            log(now, "MSG", "ArduCopter V4.5.7 (2a3dc4b7)")
            log(now, "PARM", "FRAME_CLASS", 1.0, 1.0)
            log(now, "MODE", 5, 5, 0)
        if now.armed != armed:
            log(now, "EV", 10 if now.armed else 11)
            armed = now.armed
        if now.tick % 10 == 0:
            log(now, "VIBE", 0, 90.0 if now.shaken else 5.0, 5.0, 5.0, 0)
            log(now, "BAT", 0, 12.4, 12.4, 15.0)
        if now.tick % 2 == 0:
            week_ms, course = 345_600_000 + now.tick * 100, 90.0
            log(now, "GPS", 0, 3, week_ms, 2300, 12, 80, *where, 50_000 + round(now.up_m * 100),
                now.east_mps, course, -now.climb_mps)  # fmt: skip
        log(now, "ATT", 0.0, 0.6, 0.0, 0.0, 0.0, 0.0)
        log(now, "IMU", 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
        log(now, "POS", *where, 500.0 + now.up_m, now.up_m, now.up_m)
    return b"".join(found)


# Fields of each topic with struct's form; arrays as PX4 writes them.
TOPICS = {
    "vehicle_status": ("QBBB", "uint64_t timestamp;uint8_t nav_state;uint8_t arming_state;"
                       "uint8_t vehicle_type;"),
    "vehicle_land_detected": ("Q?", "uint64_t timestamp;bool landed;"),
    "vehicle_attitude": ("Q4f", "uint64_t timestamp;float[4] q;"),
    "vehicle_local_position": ("Q6f", "uint64_t timestamp;float x;float y;float z;float vx;"
                               "float vy;float vz;"),
    "vehicle_global_position": ("Qddf", "uint64_t timestamp;double lat;double lon;float alt;"),
    "vehicle_gps_position": ("QQddd3fBB", "uint64_t timestamp;uint64_t time_utc_usec;"
                             "double latitude_deg;double longitude_deg;double altitude_msl_m;"
                             "float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;"
                             "uint8_t satellites_used;"),
    "sensor_combined": ("Q6f", "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"),
    "vehicle_imu_status": ("Qf", "uint64_t timestamp;float accel_vibration_metric;"),
    "battery_status": ("Qff", "uint64_t timestamp;float voltage_v;float current_a;"),
}  # fmt: skip


def ulog(stamp: Stamp = unmoved, place: tuple[float, float] = HERE, stamped: bool = True) -> bytes:
    """The flight as PX4 logs it; `stamp` moves the timestamps of topics and of the header."""
    found: list[bytes] = []

    def message(kind: str, payload: bytes) -> None:
        found.append(pack("<H", len(payload)) + kind.encode() + payload)

    message("B", bytes(40))
    for name, (_, fields) in TOPICS.items():
        fields = fields if stamped else fields.removeprefix("uint64_t timestamp;")
        message("F", f"{name}:{fields}".encode())
    key = b"char[3] sys_name"
    message("I", pack("B", len(key)) + key + b"PX4")
    key = b"int32_t MAV_TYPE"
    message("P", pack("B", len(key)) + key + pack("<i", 2))
    for number, name in enumerate(TOPICS):
        message("A", pack("<BH", 0, number) + name.encode())
    ids = {name: number for number, name in enumerate(TOPICS)}
    begin = len(found)

    def log(now: Instant, name: str, *values: object) -> None:
        t_us = stamp(BOOT_US + round(now.t_s * 1e6), len(found) - begin) % (1 << 64)
        row = pack("<" + TOPICS[name][0], t_us, *values)
        message("D", pack("<H", ids[name]) + (row if stamped else row[8:]))

    for now in instants(place):
        if now.tick % 10 == 0:
            log(now, "vehicle_status", 4, 2 if now.armed else 1, 1)
            log(now, "vehicle_land_detected", not now.flying)
            log(now, "vehicle_imu_status", 12.0 if now.shaken else 1.0)
            log(now, "battery_status", 15.9, 15.0)
        if now.tick % 2 == 0:
            utc_us = NOON_US + round(now.t_s * 1e6)
            log(now, "vehicle_gps_position", utc_us, now.lat_deg, now.lon_deg, 500.0 + now.up_m,
                0.0, now.east_mps, -now.climb_mps, 3, 12)  # fmt: skip
        east_m = 2.0 * min(max(now.t_s - 11.0, 0.0), 29.0)
        log(now, "vehicle_attitude", 1.0, 0.005, 0.0, 0.0)
        motion = (0.0, now.east_mps, -now.climb_mps)
        log(now, "vehicle_local_position", 0.0, east_m, -now.up_m, *motion)
        log(now, "vehicle_global_position", now.lat_deg, now.lon_deg, 500.0 + now.up_m)
        log(now, "sensor_combined", 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
    start_us = stamp(BOOT_US, 0) % (1 << 64)
    return b"ULog\x01\x12\x35\x01" + pack("<Q", start_us) + b"".join(found)


FLIGHTS = {".tlog": tlog, ".bin": dataflash, ".ulg": ulog}
