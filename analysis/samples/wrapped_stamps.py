"""Unwrap the 32-bit microsecond timestamps of SERVO_OUTPUT_RAW [1]_.

They wrap every 72 minutes; `time_boot_ms` in other messages of the same stream does not and
determines how many times they have wrapped.

References
----------
.. [1] MAVLink common message set, SERVO_OUTPUT_RAW.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.samples.block import Indices, Stamps

WRAP_PERIOD_US = 1 << 32
WRAPPED_MESSAGE = "SERVO_OUTPUT_RAW"
BOOT_TIME_FIELD = "time_boot_ms"


class BootTime:
    """Tracks the time since boot along a stream, from all messages with `time_boot_ms`."""

    def __init__(self) -> None:
        self._newest_us: int | None = None

    def unwrap(
        self,
        t_us: Stamps,
        place: Indices,
        columns: Mapping[str, NDArray[Any]],
        orders: Mapping[str, Indices],
    ) -> Stamps:
        """Unwrapped timestamps (m,) of frames at positions `place` (m,) in the stream."""
        timed = [name for name in columns if BOOT_TIME_FIELD in (columns[name].dtype.names or ())]
        places = [np.zeros(0, np.int64)] + [orders[name] for name in timed]
        times = [np.zeros(0, np.int64)] + [
            columns[n][BOOT_TIME_FIELD].astype(np.int64) for n in timed
        ]
        known_at, known_us = np.concatenate(places), np.concatenate(times) * 1000
        by_place = np.argsort(known_at, kind="stable")
        known_at, known_us = known_at[by_place], known_us[by_place]
        if self._newest_us is not None:  # from the previous frames
            known_at, known_us = np.append(-1, known_at), np.append(self._newest_us, known_us)
        if not len(known_at):
            return t_us
        self._newest_us = int(known_us[-1])
        # The last boot time before each frame; for the very first frames the first one after them.
        near = np.maximum(np.searchsorted(known_at, place) - 1, 0)
        rounds: Stamps = np.round((known_us[near] - t_us) / WRAP_PERIOD_US).astype(np.int64)
        return t_us + rounds * WRAP_PERIOD_US
