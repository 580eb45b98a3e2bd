"""When the receiver has a satellite's signal, and when it has read its ephemeris."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from simvehicle.gnss.gnss_config import ReceiverConfig

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]
Stamps = NDArray[np.int64]

NEVER_US = np.iinfo(np.int64).max // 4  # leaves room to add to
LONG_AGO_US = -NEVER_US
US_PER_S = 1e6


class Tracking(msgspec.Struct, frozen=True):
    """The receiver's search; the arrays are (n,) stamps.

    `tracked_from_us` is when it finds (found) the signal, `message_us` when it has read (will have
    read) the ephemeris, which it then keeps. `running` says that it has power, `cold` that it
    starts (started) without knowing anything; `signal` (n,) is what was there at the last epoch.
    """

    running: bool
    cold: bool
    signal: Mask
    tracked_from_us: Stamps
    message_us: Stamps

    def tracked(self, t_us: int) -> Mask:
        """Satellites whose signal it follows."""
        return self.tracked_from_us <= t_us

    def usable(self, t_us: int) -> Mask:
        """Satellites it can use for a position."""
        return (self.tracked_from_us <= t_us) & (self.message_us <= t_us)


def powered_off_tracking(count: int, cold: bool) -> Tracking:
    """A receiver without power, which will start cold or hot."""
    never = np.full(count, NEVER_US)
    return Tracking(False, cold, np.zeros(count, dtype=bool), never, never)


def update_tracking(
    old: Tracking,
    signal: Mask,
    t_us: int,
    receiver: ReceiverConfig,
    search_s: Vector,
    message_s: Vector,
) -> Tracking:
    """The search one epoch on.

    Parameters
    ----------
    old : Tracking
        One epoch before; without power, this epoch is power-on.
    signal : (n,) array
        Which signals are there, strong enough and above the mask.
    t_us : int
        This epoch.
    receiver : ReceiverConfig
        Times of the search.
    search_s, message_s : (n,) arrays
        What a cold start takes to find a signal, and to read an ephemeris from then on.
    """
    # Nothing came or went: the stamps stand as they are.
    if old.running and np.array_equal(signal, old.signal):
        return old
    wait_s = np.full(len(signal), receiver.reacquire_s)
    message_us = old.message_us
    if not old.running:
        wait_s = search_s if old.cold else np.zeros(len(signal))
        message_us = np.full(len(signal), NEVER_US if old.cold else LONG_AGO_US)
    found_us = t_us + (wait_s * US_PER_S).astype(np.int64)
    from_us = np.where(old.tracked_from_us == NEVER_US, found_us, old.tracked_from_us)
    from_us = np.where(signal, from_us, NEVER_US)
    read_us = from_us + np.where(signal, message_s * US_PER_S, 0.0).astype(np.int64)
    # What has been read is kept; a reading that was cut off begins anew.
    message_us = np.where(message_us <= t_us, message_us, read_us)
    return Tracking(True, old.cold, signal, from_us, message_us)
