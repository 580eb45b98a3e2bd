"""The state of a flight in flat records, which the compiled functions of a step share.

`FLIGHT` is the vehicle in its surroundings, `SENSOR` one compiled sensor on board. Functions take
arrays of records, as numba takes 2 us to accept a single one.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.wire.plant_names import SENSORS
from simvehicle.environment.air import GUST_DRAWS, GUST_FILTERS, LAW_SIZE
from simvehicle.environment.geolocation import HOME_SIZE, LOCATION_SIZE
from simvehicle.sensors.error_model import BLOCK
from simvehicle.vehicles.vehicle import LOAD_SIZE, SURROUNDINGS_SIZE

Records = NDArray[Any]
WARMING, COMPASS = 0, 1  # in `disturbance`
MAX_STATES, MAX_CONTROLS = 64, 32  # room for vehicles of other packages too
FLIGHT = np.dtype(
    [
        ("t_us", "i8"),
        ("rate_hz", "f8"),  # of the steps
        ("x", "f8", MAX_STATES),
        ("load", "f8", LOAD_SIZE),
        ("controls", "f8", MAX_CONTROLS),
        ("armed", "i8"),
        ("wind", "f8", 3),
        ("here", "f8", LOCATION_SIZE),  # output of `locate_state`
        ("home", "f8", HOME_SIZE),
        ("disturbance", "f8", len(SENSORS)),  # of the sensors: warming [K], compass [gauss/A]
        ("ground_m", "f8"),  # height of the ground above mean sea level
        ("agl_m", "f8"),
        ("weather", "f8", LAW_SIZE),  # inputs of `step_wind`
        ("filters", "f8", GUST_FILTERS),
        ("draws", "f8", (BLOCK, GUST_DRAWS)),
        ("row", "i8"),  # the last one used of `draws`
        ("wing", "i8"),  # a fixed wing, or else a multirotor
        ("states", "i8"),  # used of `x`
        ("actuators", "i8"),  # used of `controls`
        # The next step: whether it is prepared, its number, end, cut, wind and surroundings
        ("prepared", "i8"),
        ("count", "i8"),
        ("next_us", "i8"),
        ("substeps", "i8"),
        ("dt", "f8"),
        ("next_wind", "f8", 3),
        ("around", "f8", SURROUNDINGS_SIZE),
        ("after", "f8", MAX_STATES),
        ("used_up", "i8"),  # a block of random draws has no row left
    ],
    align=True,
)
SENSOR = np.dtype(
    [
        ("kind", "i8"),
        ("id", "i8"),
        ("rate_hz", "f8"),
        ("scale", "f8", 2),  # of each noise model
        ("constants", "f8", 8),  # of the kind
        ("count", "i8"),  # the next sample's number, and when it is due
        ("due_us", "f8"),
        ("errors", "f8", (BLOCK, 6)),  # the coming samples' errors, and the next one's row
        ("row", "i8"),
        ("values", "f8", 6),  # the newest sample, and whether this step delivers it
        ("fresh", "i8"),
    ],
    align=True,
)


class Board(NamedTuple):
    """The records of one flight: `flight` (1,) and `sensors` (n,)."""

    flight: Records
    sensors: Records
