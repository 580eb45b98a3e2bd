"""The arrays that plain steps work on, and what their columns mean."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simvehicle.environment.geolocation import LOCATION_SIZE
from simvehicle.hil.state_kernel import PAYLOAD_SIZE
from simvehicle.vehicles.vehicle import LOAD_SIZE

Doubles = NDArray[np.float64]
Integers = NDArray[np.int64]
Octets = NDArray[np.uint8]

# Entries of `words`: the instant of the last step and the next one's number, instant and cut
(T_US, COUNT, NEXT_US, SUBSTEPS, ROW, FIXED_WING, ARMED, SEQ, SYSTEM, COMPONENT, START_US,
 LENGTH, WORDS) = range(13)  # fmt: skip
# Entries of `numbers`: the next step's part, the longest one, the rate of steps, heights [m]
DT, LONGEST_S, RATE_HZ, GROUND_M, GEOID_M, AGL_M, NUMBERS = range(7)
# Columns of `sensors`: what one is, its id, its samples so far, its first noise and the row there
KIND, ID, SAMPLES, NOISE, AT, SENSOR = range(6)
IMU, MAG, BARO, PITOT = range(4)  # kinds
# Columns of `gains`; a compass has its field there, a barometer its drift with temperature
SENSOR_HZ, DUE_US, SCALE, LIMIT, SCALE_2, LIMIT_2, FIELD, GAIN = 0, 1, 2, 3, 4, 5, 6, 9
DRIFT = FIELD
SENSOR_FLOATS, IDS = 13, 3  # of HIL_SENSOR
ROOM = 1024  # bytes of a step's frames: three HIL_SENSOR and the truth
STAMP, FLOATS, UPDATED, SENSOR_ID, SENSOR_SIZE = 0, 8, 60, 64, 65  # places in HIL_SENSOR's payload


class Plain(NamedTuple):
    """Everything that a plain step reads and writes; n is the number of sensors."""

    words: Integers  # (WORDS,)
    numbers: Doubles  # (NUMBERS,)
    x: Doubles  # (m,) the vehicle's state
    after: Doubles  # (m,)
    controls: Doubles  # (k,)
    load: Doubles  # (LOAD_SIZE,)
    wind: Doubles  # (2, 3) of the last step and of the next one
    around: Doubles  # (9,)
    here: Doubles  # (LOCATION_SIZE,) output of `locate_state`
    home: Doubles  # (13,)
    packed: Doubles  # the vehicle's parameters
    law: Doubles  # (11,) the weather's, and its filters and draws
    filters: Doubles  # (5,)
    draws: Doubles  # (BLOCK, 5)
    sensors: Integers  # (n, SENSOR)
    gains: Doubles  # (n, GAIN)
    noise: Doubles  # (noises, BLOCK, 3) errors to come
    fields: Doubles  # (IDS, SENSOR_FLOATS) what HIL_SENSOR holds
    payload: Octets  # (SENSOR_SIZE,) room for one of HIL_SENSOR
    truth: Octets  # (64,) and for the truth
    out: Octets  # (ROOM,) the step's frames
    crc: NDArray[np.uint16]  # (8, 256)


def new_arrays(
    states: int, controls: int, sensors: int, noises: int, block: int
) -> dict[str, object]:
    """The arrays that no other object owns."""
    return {
        "words": np.zeros(WORDS, dtype=np.int64),
        "numbers": np.zeros(NUMBERS),
        "x": np.zeros(states),
        "after": np.zeros(states),
        "controls": np.zeros(controls),
        "load": np.zeros(LOAD_SIZE),
        "wind": np.zeros((2, 3)),
        "around": np.zeros(9),
        "here": np.zeros(LOCATION_SIZE),
        "sensors": np.zeros((sensors, SENSOR), dtype=np.int64),
        "gains": np.zeros((sensors, GAIN)),
        "noise": np.zeros((noises, block, 3)),
        "fields": np.zeros((IDS, SENSOR_FLOATS)),
        "payload": np.zeros(SENSOR_SIZE, dtype=np.uint8),
        "truth": np.zeros(PAYLOAD_SIZE, dtype=np.uint8),
        "out": np.zeros(ROOM, dtype=np.uint8),
    }
