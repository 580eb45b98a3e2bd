"""The state that the GNSS sensor carries from one epoch to the next."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.arrays import Array
from simvehicle.gnss.receiver import NO_FIX, ReceiverFix
from simvehicle.gnss.satellite_orbits import Orbits
from simvehicle.gnss.signal_errors import ReceiverClock
from simvehicle.gnss.tracking import Stamps, Tracking


class SignalFaults(msgspec.Struct, frozen=True):
    """Plant faults of the signals and of the receiver.

    The rows of `signals` (4, n) are metres added to the range, decibels taken off C/N0, signal loss
    (not 0), and m/s added to the range rate. The rows of `spoof` (4, n) are the spoofed position's
    offset north, east and down and the spoofed delay [m]. `off` is not 0 while the receiver is off.
    """

    signals: Array
    spoof: Array
    off: float = 0.0


class Broadcast(msgspec.Struct, frozen=True):
    """The ephemerides in use: their indices, which satellites have one, and their orbits.

    The choice is valid up to and including `until_s` (seconds of the constellation's week).
    """

    chosen: tuple[int | None, ...]
    valid: NDArray[np.bool_]
    orbits: Orbits
    until_s: float


class GnssState(msgspec.Struct, frozen=True):
    """State of `GnssSensor`; arrays (n,) have one entry per satellite of its constellation.

    The rows of `wander` (3, n) are the unit-variance Gauss-Markov processes of multipath, orbit and
    C/N0. `search_s`, `message_s` are the acquisition and ephemeris times of a cold start. `sent_us`
    is when each ephemeris was last sent, `last_spoof` (4, n) the `spoof` of the last epoch.
    """

    t_us: int | None
    clock: ReceiverClock
    wander: Array
    search_s: Array
    message_s: Array
    broadcast: Broadcast
    tracking: Tracking
    sent_us: Stamps
    faults: SignalFaults
    last_spoof: Array
    fix: ReceiverFix = NO_FIX
