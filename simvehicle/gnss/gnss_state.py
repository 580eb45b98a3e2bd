"""What moves in the GNSS sensor from one epoch to the next."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from simvehicle.gnss.receiver import ReceiverFix
from simvehicle.gnss.satellite_orbits import Orbits
from simvehicle.gnss.signal_errors import ReceiverClock
from simvehicle.gnss.tracking import Stamps, Tracking

Vector = NDArray[np.float64]


class SignalFaults(msgspec.Struct, frozen=True):
    """What a scenario does to the signals before the receiver.

    The rows of `signals` (4, n) are metres added to the range, decibels taken from the signal,
    whether it is lost (not 0), and m/s added to its rate; those of `spoof` (4, n) metres north,
    east and down that its signal is made up for, and of delay. `off` is not 0 where the receiver
    is.
    """

    signals: Vector
    spoof: Vector
    off: float = 0.0


class Broadcast(msgspec.Struct, frozen=True):
    """Which ephemerides are in use: their indices, which satellites have one, and their orbits.

    It is the right choice up to and including `until_s` (seconds of the constellation's week).
    """

    chosen: tuple[int | None, ...]
    valid: NDArray[np.bool_]
    orbits: Orbits
    until_s: float


class GnssState(msgspec.Struct, frozen=True):
    """State of `GnssSensor`; arrays (n,) run along its constellation's satellites.

    The rows of `wander` (3, n) are the unit-variance processes of multipath, orbit and C/N0.
    `search_s`, `message_s` are what a cold
    start takes for each satellite. `sent_us` is when the ephemerides last went out, `last_spoof`
    (4, n) the `spoof` of the last epoch.
    """

    t_us: int | None
    clock: ReceiverClock
    wander: Vector
    search_s: Vector
    message_s: Vector
    broadcast: Broadcast
    tracking: Tracking
    sent_us: Stamps
    faults: SignalFaults
    last_spoof: Vector
    fix: ReceiverFix | None = None
