"""What moves in the GNSS sensor from one epoch to the next."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simvehicle.gnss.ephemeris import Orbits
from simvehicle.gnss.errors import Clock
from simvehicle.gnss.receiver import Fix
from simvehicle.gnss.tracking import Stamps, Tracking

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Faults:
    """What a scenario does to the signals before the receiver; arrays are (n,).

    `lost` and `off` are not 0 where so.
    """

    offset_m: Vector
    cn0_drop_db: Vector
    lost: Vector
    off: float = 0.0


@dataclass(frozen=True, slots=True)
class Broadcast:
    """Which ephemerides are in use: their indices, which satellites have one, and their orbits.

    It is the right choice up to and including `until_s` (seconds of the constellation's week).
    """

    chosen: tuple[int | None, ...]
    valid: NDArray[np.bool_]
    orbits: Orbits
    until_s: float


@dataclass(frozen=True, slots=True)
class GnssState:
    """State of `GnssSensor`; arrays (n,) run along its constellation's satellites.

    `multipath`, `orbit`, `cn0` are unit-variance processes. `search_s`, `message_s` are what a cold
    start takes for each satellite. `sent_us` is when the ephemerides last went out.
    """

    t_us: int | None
    clock: Clock
    multipath: Vector
    orbit: Vector
    cn0: Vector
    search_s: Vector
    message_s: Vector
    broadcast: Broadcast
    tracking: Tracking
    sent_us: Stamps
    faults: Faults
    fix: Fix | None = None
