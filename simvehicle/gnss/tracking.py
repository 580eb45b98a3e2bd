"""Signal tracking: when the receiver has a satellite's signal and has read its ephemeris."""

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.arrays import Array
from simvehicle.gnss.gnss_config import ReceiverConfig

Mask = NDArray[np.bool_]
Stamps = NDArray[np.int64]

NEVER_US = np.iinfo(np.int64).max // 4  # a quarter of the range, so that sums do not overflow
LONG_AGO_US = -NEVER_US
US_PER_S = 1e6


class Tracking(msgspec.Struct, frozen=True):
    """The receiver's tracking state; the time arrays are (n,) in us.

    `tracked_from_us` is when the receiver acquires the signal and `message_us` when it has read the
    ephemeris, which it then keeps; both may lie in the future. `running` says that it has power,
    `cold` that it starts without stored data; `signal` (n,) marks the signals at the last epoch.
    """

    running: bool
    cold: bool
    signal: Mask
    tracked_from_us: Stamps
    message_us: Stamps

    def tracked(self, t_us: int) -> Mask:
        """Mask of the satellites whose signal is tracked."""
        return self.tracked_from_us <= t_us

    def usable(self, t_us: int) -> Mask:
        """Mask of the satellites that can be used for a fix."""
        return (self.tracked_from_us <= t_us) & (self.message_us <= t_us)


def powered_off_tracking(count: int, cold: bool) -> Tracking:
    """The state of a receiver without power, which will start cold or hot."""
    never = np.full(count, NEVER_US)
    return Tracking(False, cold, np.zeros(count, dtype=bool), never, never)


def update_tracking(
    old: Tracking,
    signal: Mask,
    t_us: int,
    receiver: ReceiverConfig,
    search_s: Array,
    message_s: Array,
) -> Tracking:
    """Update the tracking state for one epoch.

    Parameters
    ----------
    old : Tracking
        The state of the last epoch; without power, this epoch is power-on.
    signal : (n,) array
        Mask of the signals that are strong enough and above the elevation mask.
    t_us : int
        Time of this epoch.
    receiver : ReceiverConfig
        Configuration of the receiver.
    search_s, message_s : (n,) arrays
        Time to acquire each signal after a cold start, and to read its ephemeris from then on.
    """
    # No signal appeared or was lost: the times stay.
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
    # An ephemeris already read is kept; an interrupted reading starts again.
    message_us = np.where(message_us <= t_us, message_us, read_us)
    return Tracking(True, old.cold, signal, from_us, message_us)
