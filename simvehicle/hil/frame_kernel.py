"""The frames of every step, packed by compiled code: HIL_SENSOR and HIL_STATE_QUATERNION.

HIL_SENSOR has the last value of every field; `fields_updated` marks the new ones.
"""

import math

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.compile import compiled, constant, inlined
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3, STANDARD_GRAVITY_MPS2
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import STX_V2
from mavproxy_fault.wire.framing import range_crc
from simvehicle.environment.geolocation import AIR, AIR_VELOCITY, ATTITUDE, GEOID, VELOCITY
from simvehicle.sensors.flight_record import Records
from simvehicle.vehicles.rigidbody_kernel import P
from simvehicle.vehicles.vehicle import FORCE

Octets = NDArray[np.uint8]

HIL_SENSOR, TRUTH = message_layout("HIL_SENSOR"), message_layout("HIL_STATE_QUATERNION")
_SENSOR_ID, _SENSOR_EXTRA = constant(HIL_SENSOR.id), constant(HIL_SENSOR.crc_extra)
_TRUTH_ID, _TRUTH_EXTRA = constant(TRUTH.id), constant(TRUTH.crc_extra)
IDS = 3  # PX4 ignores higher ids
FIELDS = 13  # floats of HIL_SENSOR
# The values of each kind of compiled sensor: how many, their fields, and their unit on the wire
# (hPa for pressures); HIL_SENSOR_UPDATED_* of all of them
COUNTS = np.array([6, 3, 3, 1])
PLACES = np.array([[0, 1, 2, 3, 4, 5], [6, 7, 8, 0, 0, 0], [9, 11, 12, 0, 0, 0], [10] * 6])
UNITS = np.array([[1.0] * 6, [1.0] * 6, [100.0, *[1.0] * 5], [100.0] * 6])
UPDATED = np.array([0x3F, 0x1C0, 0x1A00, 0x400])
# Starts in the payloads
_STAMP, _FLOATS, _UPDATED, _ID, _SENSOR_SIZE = 0, 8, 60, 64, constant(65)
_PLACES, _SHORTS, _TRUTH_SIZE = 36, 48, constant(64)
_RATES = 4  # index in the truth's floats, after the quaternion
_INDICATED, _TRUE_AIRSPEED, _FORCE = 3, 4, 5  # indices in the shorts, after the velocity
MPS2_TO_MILLI_G = 1000.0 / STANDARD_GRAVITY_MPS2
RAD_TO_DEGE7 = 1e7 * 180.0 / math.pi
CM = 100.0
ROOM = 1024  # bytes of a step's frames: three HIL_SENSOR and the truth

PACKER = np.dtype(
    [
        ("start_us", "i8"),  # timestamp at the flight's t_us = 0
        ("seq", "i8"),
        ("system", "i8"),
        ("component", "i8"),
        ("fields", "f8", (IDS, FIELDS)),
        ("updated", "i8", IDS),
        ("payload", "u1", 72),
        ("out", "u1", ROOM),  # the frames, and their length together
        ("length", "i8"),
        ("crc", "u2", (8, 256)),
    ],
    align=True,
)


@compiled
def pack_sensors(flight: Records, sensors: Records, packer: Records) -> None:
    """Begin the frames of a step: a HIL_SENSOR for each id with fresh values."""
    f, w = flight[0], packer[0]
    w.length = 0
    for number in range(IDS):
        w.updated[number] = 0
    for at in range(sensors.shape[0]):
        s = sensors[at]
        if s.fresh:
            for i in range(COUNTS[s.kind]):
                w.fields[s.id, PLACES[s.kind, i]] = s.values[i] / UNITS[s.kind, i]
            w.updated[s.id] |= UPDATED[s.kind]
    for number in range(IDS):
        if w.updated[number]:
            w.payload[_STAMP:_FLOATS].view(np.int64)[0] = f.t_us + w.start_us
            floats = w.payload[_FLOATS:_UPDATED].view(np.float32)
            for i in range(FIELDS):
                floats[i] = w.fields[number, i]
            w.payload[_UPDATED:_ID].view(np.uint32)[0] = w.updated[number]
            w.payload[_ID] = number
            _frame(packer, _SENSOR_SIZE, _SENSOR_ID, _SENSOR_EXTRA)


@inlined
def _to_short(value: float) -> int:
    return int(min(max(np.rint(value), -32768.0), 32767.0))


@inlined
def _to_unsigned_short(value: float) -> int:
    """An unsigned short as the signed short with the same bits."""
    unsigned = int(min(max(np.rint(value), 0.0), 65535.0))
    return unsigned if unsigned < 32768 else unsigned - 65536


@compiled
def pack_truth(flight: Records, packer: Records) -> None:
    """Append HIL_STATE_QUATERNION.

    Accelerations are the specific force in mG, as in other simulators (-1000 at rest); values
    outside a field's range saturate.
    """
    f, w = flight[0], packer[0]
    here = f.here
    w.payload[_STAMP:_FLOATS].view(np.int64)[0] = f.t_us + w.start_us
    floats = w.payload[_FLOATS:_PLACES].view(np.float32)
    places = w.payload[_PLACES:_SHORTS].view(np.int32)
    shorts = w.payload[_SHORTS:_TRUTH_SIZE].view(np.int16)
    for i in range(4):
        floats[i] = here[ATTITUDE + i]
    square = 0.0
    for i in range(3):
        floats[_RATES + i] = f.x[P + i]
        shorts[i] = _to_short(here[VELOCITY + i] * CM)
        shorts[_FORCE + i] = _to_short(f.load[FORCE + i] * MPS2_TO_MILLI_G)
        square += here[AIR_VELOCITY + i] * here[AIR_VELOCITY + i]
    places[0] = int(np.rint(here[0] * RAD_TO_DEGE7))
    places[1] = int(np.rint(here[1] * RAD_TO_DEGE7))
    places[2] = int(np.rint((here[2] - f.home[GEOID]) * 1e3))
    airspeed = math.sqrt(square) * CM
    relative = math.sqrt(here[AIR + 2] / SEA_LEVEL_DENSITY_KGPM3)
    shorts[_INDICATED] = _to_unsigned_short(airspeed * relative)
    shorts[_TRUE_AIRSPEED] = _to_unsigned_short(airspeed)
    _frame(packer, _TRUTH_SIZE, _TRUTH_ID, _TRUTH_EXTRA)


@compiled
def _frame(packer: Records, size: int, number: int, extra: int) -> None:
    """Append the frame of the payload, with its trailing zeros cut."""
    w = packer[0]
    out, at = w.out, w.length
    while size > 1 and w.payload[size - 1] == 0:
        size -= 1
    out[at], out[at + 1], out[at + 2], out[at + 3] = STX_V2, size, 0, 0
    out[at + 4], out[at + 5], out[at + 6] = w.seq, w.system, w.component
    out[at + 7], out[at + 8], out[at + 9] = number & 0xFF, number >> 8 & 0xFF, number >> 16
    for n in range(size):
        out[at + 10 + n] = w.payload[n]
    base, tail = out.ctypes.data, at + 10 + size
    found = range_crc(base + at + 1, base + tail, np.uint64(extra), w.crc)
    out[tail], out[tail + 1] = found & np.uint64(0xFF), found >> np.uint64(8)
    w.length = tail + 2
    w.seq = (w.seq + 1) & 0xFF
