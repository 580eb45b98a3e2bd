"""A plain step, compiled: from commands to the frames that report it.

Each function duplicates the Python code that it names; where possible both share one source.
`tests/simvehicle/plain` compares the two byte by byte.
"""

import numpy as np

from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.rotations.one_rotation import rotate_to_body
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.framing import range_crc
from simvehicle.environment.air import SEA_LEVEL_K, pressure_altitude, step_wind
from simvehicle.environment.geolocation import (
    AIR,
    AIR_VELOCITY,
    ATTITUDE,
    LOCAL_GRAVITY,
    VELOCITY,
    locate_state,
)
from simvehicle.hil.hil_frames import ACCEL, DIFF_PRESSURE, GYRO, PA_PER_HPA
from simvehicle.hil.hil_frames import BARO as BARO_BITS
from simvehicle.hil.hil_frames import MAG as MAG_BITS
from simvehicle.hil.state_kernel import fill_truth_payload
from simvehicle.plain import plain_arrays as k
from simvehicle.plain.plain_arrays import Octets, Plain
from simvehicle.sensors import barometer, imu
from simvehicle.vehicles.actuators import (
    ELEVATOR,
    LEFT_AILERON,
    RIGHT_AILERON,
    RUDDER,
    THROTTLE,
)
from simvehicle.vehicles.fixedwing import fixedwing_flight
from simvehicle.vehicles.multirotor import multirotor_flight
from simvehicle.vehicles.rigidbody_kernel import DOWN, RIGID_SIZE, P
from simvehicle.vehicles.vehicle import BATTERY_SAG, DENSITY, FORCE, GRAVITY, GROUND, VOLTS, WIND

HIL_SENSOR, HIL_STATE_QUATERNION = (
    message_layout("HIL_SENSOR"),
    message_layout("HIL_STATE_QUATERNION"),
)
_SENSOR_ID, _SENSOR_EXTRA = HIL_SENSOR.id, HIL_SENSOR.crc_extra
_TRUTH_ID, _TRUTH_EXTRA = HIL_STATE_QUATERNION.id, HIL_STATE_QUATERNION.crc_extra
_ICE_K = barometer.CELSIUS_ZERO_K
# Places among HIL_SENSOR's floats
_ACCEL, _GYRO, _MAG, _PRESSURE, _DIFFERENCE, _ALTITUDE, _CELSIUS = 0, 3, 6, 9, 10, 11, 12

_measured = inlined(imu.apply_triad_errors)
_into_body = inlined(rotate_to_body)
_pressure_altitude = inlined(pressure_altitude)


@inlined
def _limited(value: float, low: float) -> float:
    return min(max(value, low), 1.0)


@compiled
def command(p: Plain, channels: "np.ndarray[tuple[int], np.dtype[np.float32]]") -> None:
    """Commands of an autopilot's channels (16,); as `actuators.read_controls` and its mixes.

    Channels that are not finite count as 0, and without arming all do.
    """
    values = np.empty(channels.shape[0])
    for i in range(channels.shape[0]):
        values[i] = channels[i]
        if not np.isfinite(channels[i]):
            values[i] = 0.0
    if not p.words[k.ARMED]:
        p.controls[:] = 0.0
    elif p.words[k.FIXED_WING]:
        right, left = _limited(values[RIGHT_AILERON], -1.0), _limited(values[LEFT_AILERON], -1.0)
        p.controls[0] = -_limited(values[ELEVATOR], -1.0)
        p.controls[1] = 0.5 * (right - left)
        p.controls[2] = -_limited(values[RUDDER], -1.0)
        p.controls[3] = _limited(values[THROTTLE], 0.0)
    else:
        for i in range(p.controls.shape[0]):
            p.controls[i] = _limited(values[i], 0.0)


@compiled
def look_ahead(p: Plain) -> None:
    """Prepare all of the next step that does not depend on commands; as `Simulation.prepare`."""
    words, numbers, here, around = p.words, p.numbers, p.here, p.around
    words[k.COUNT] += 1
    words[k.NEXT_US] = np.int64(np.rint(words[k.COUNT] * 1e6 / numbers[k.RATE_HZ]))
    dt = (words[k.NEXT_US] - words[k.T_US]) * 1e-6
    words[k.ROW] += 1
    air, wind = here[AIR_VELOCITY:LOCAL_GRAVITY], p.wind[1]
    step_wind(p.filters, p.draws[words[k.ROW]], p.law, p.x, air, numbers[k.AGL_M], dt, wind)
    for i in range(3):
        around[WIND + i] = wind[i]
        around[GRAVITY + i] = here[LOCAL_GRAVITY + i]
    around[DENSITY], around[BATTERY_SAG] = here[AIR + 2], 1.0
    around[GROUND] = p.x[DOWN] + numbers[k.AGL_M]
    words[k.SUBSTEPS] = max(1, int(np.ceil(dt / numbers[k.LONGEST_S] - 1e-9)))
    numbers[k.DT] = dt / words[k.SUBSTEPS]


@inlined
def _inertial(p: Plain, at: int, fields: k.Doubles) -> int:
    gains, row = p.gains[at], p.sensors[at, k.AT]
    a, b = p.noise[p.sensors[at, k.NOISE], row], p.noise[p.sensors[at, k.NOISE] + 1, row]
    rates = (p.x[P], p.x[P + 1], p.x[P + 2])
    force = (p.load[FORCE], p.load[FORCE + 1], p.load[FORCE + 2])
    gyro = _measured(rates, gains[k.SCALE], (a[0], a[1], a[2]), gains[k.LIMIT])
    accel = _measured(force, gains[k.SCALE_2], (b[0], b[1], b[2]), gains[k.LIMIT_2])
    for i in range(3):
        fields[_ACCEL + i] = accel[i]
        fields[_GYRO + i] = gyro[i]
    return ACCEL | GYRO


@inlined
def _magnetic(p: Plain, at: int, fields: k.Doubles) -> int:
    gains, here = p.gains[at], p.here
    e = p.noise[p.sensors[at, k.NOISE], p.sensors[at, k.AT]]
    q = (here[ATTITUDE], here[ATTITUDE + 1], here[ATTITUDE + 2], here[ATTITUDE + 3])
    field = (gains[k.FIELD], gains[k.FIELD + 1], gains[k.FIELD + 2])
    seen = _measured(_into_body(q, field), gains[k.SCALE], (e[0], e[1], e[2]), np.inf)
    for i in range(3):
        fields[_MAG + i] = seen[i]
    return MAG_BITS


@inlined
def _barometric(p: Plain, at: int, fields: k.Doubles) -> int:
    gains, kelvin = p.gains[at], p.here[AIR + 1]
    error = p.noise[p.sensors[at, k.NOISE], p.sensors[at, k.AT], 0]
    drift = gains[k.DRIFT] * (kelvin - SEA_LEVEL_K)
    pressure = (1.0 + gains[k.SCALE]) * p.here[AIR] + error + drift
    fields[_PRESSURE] = pressure / PA_PER_HPA
    fields[_ALTITUDE] = _pressure_altitude(max(pressure, 1.0))
    fields[_CELSIUS] = kelvin - _ICE_K
    return BARO_BITS


@inlined
def _dynamic(p: Plain, at: int, fields: k.Doubles) -> int:
    u, v, w = p.here[AIR_VELOCITY], p.here[AIR_VELOCITY + 1], p.here[AIR_VELOCITY + 2]
    error = p.noise[p.sensors[at, k.NOISE], p.sensors[at, k.AT], 0]
    pressure = 0.5 * p.here[AIR + 2] * (u * u + v * v + w * w)
    pressure = (1.0 + p.gains[at, k.SCALE]) * pressure + error
    fields[_DIFFERENCE] = pressure / PA_PER_HPA
    return DIFF_PRESSURE


@compiled
def _frame(p: Plain, payload: Octets, number: int, extra: int) -> None:
    """Append the frame of a payload whose trailing zeros are cut; as `wire.frame.frame_payload`."""
    words, out = p.words, p.out
    size = payload.shape[0]
    while size > 1 and payload[size - 1] == 0:
        size -= 1
    at = words[k.LENGTH]
    out[at], out[at + 1], out[at + 2], out[at + 3] = 0xFD, size, 0, 0
    out[at + 4], out[at + 5], out[at + 6] = words[k.SEQ], words[k.SYSTEM], words[k.COMPONENT]
    out[at + 7], out[at + 8], out[at + 9] = number & 0xFF, number >> 8 & 0xFF, number >> 16
    for n in range(size):
        out[at + 10 + n] = payload[n]
    base, tail = out.ctypes.data, at + 10 + size
    found = range_crc(base + at + 1, base + tail, np.uint64(extra), p.crc)
    out[tail], out[tail + 1] = found & np.uint64(0xFF), found >> np.uint64(8)
    words[k.LENGTH] = tail + 2
    words[k.SEQ] = (words[k.SEQ] + 1) & 0xFF


@compiled
def _sense(p: Plain) -> None:
    """Readings that are due, as HIL_SENSOR of each id; as `Simulation` and `HilPacker` do."""
    words, sensors, payload = p.words, p.sensors, p.payload
    updated = np.zeros(k.IDS, dtype=np.uint32)
    for at in range(sensors.shape[0]):
        if words[k.T_US] < p.gains[at, k.DUE_US]:
            continue
        kind, number = sensors[at, k.KIND], sensors[at, k.ID]
        fields, bits = p.fields[number], 0
        if kind == k.IMU:
            bits = _inertial(p, at, fields)
        elif kind == k.MAG:
            bits = _magnetic(p, at, fields)
        elif kind == k.BARO:
            bits = _barometric(p, at, fields)
        else:
            bits = _dynamic(p, at, fields)
        updated[number] |= np.uint32(bits)
        sensors[at, k.AT] += 1
        sensors[at, k.SAMPLES] += 1
        p.gains[at, k.DUE_US] = sensors[at, k.SAMPLES] * 1e6 / p.gains[at, k.SENSOR_HZ]
    floats = payload[k.FLOATS : k.UPDATED].view(np.float32)
    payload[k.STAMP : k.FLOATS].view(np.int64)[0] = words[k.T_US] + words[k.START_US]
    for number in range(k.IDS):
        if updated[number]:
            for n in range(k.SENSOR_FLOATS):
                floats[n] = p.fields[number, n]
            payload[k.UPDATED : k.SENSOR_ID].view(np.uint32)[0] = updated[number]
            payload[k.SENSOR_ID] = number
            _frame(p, payload, _SENSOR_ID, _SENSOR_EXTRA)


@compiled
def step(p: Plain) -> bool:
    """Fly the step that was looked ahead to, and pack its frames; False if it left the numbers."""
    words, numbers, here = p.words, p.numbers, p.here
    fly = (p.x, p.controls, p.around, words[k.SUBSTEPS], numbers[k.DT], p.packed, p.after, p.load)
    if words[k.FIXED_WING]:
        fixedwing_flight.integrate_flight(*fly)
    else:
        multirotor_flight.integrate_flight(*fly)
    p.x[:] = p.after
    p.wind[0] = p.wind[1]
    words[k.T_US], words[k.LENGTH] = words[k.NEXT_US], 0
    locate_state(p.x, p.wind[0], p.home, here)
    if not np.isfinite(here[2]):
        return False
    alt_m = here[2] - numbers[k.GEOID_M]
    numbers[k.AGL_M] = alt_m - numbers[k.GROUND_M]
    _sense(p)
    p.truth[k.STAMP : k.FLOATS].view(np.int64)[0] = words[k.T_US] + words[k.START_US]
    fill_truth_payload(
        here[ATTITUDE:AIR_VELOCITY],
        p.x[P:RIGID_SIZE],
        here[VELOCITY:ATTITUDE],
        p.load[FORCE:VOLTS],
        here[AIR_VELOCITY:LOCAL_GRAVITY],
        (here[0], here[1], alt_m, here[AIR + 2]),
        p.truth,
    )
    _frame(p, p.truth, _TRUTH_ID, _TRUTH_EXTRA)
    return True
