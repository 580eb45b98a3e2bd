"""Assemble the RTCM messages of one stream to ephemerides and pseudorange epochs."""

from collections import deque
from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from analysis.samples.sample import EphemerisSample, Epoch, Sample
from mavproxy_fault.rtcm.ephemeris_messages import SYSTEMS, decode_ephemeris
from mavproxy_fault.rtcm.msm7 import SYSTEMS as MSM7_SYSTEMS
from mavproxy_fault.rtcm.msm7 import Msm7, decode_msm7
from mavproxy_fault.rtcm.transport import message_number

WEEK_S = 604_800
MAX_CLOCK_OFFSETS = 25  # chosen: the median ignores up to 12 late frames
EPHEMERIS_CACHE_SIZE = 512  # satellites repeat an ephemeris for hours


class EpochAssembler:
    """Assembles epochs; keeps the incomplete epoch, the GPS week and the clock offset.

    TUNNEL frames have no timestamp, so the timestamp of a pseudorange epoch is its GPS time plus
    the median of the latest differences between the sender's clock and GPS time. The median makes
    it robust to late frames and gaps in the sender's timestamped messages.
    """

    def __init__(self) -> None:
        self._offsets: deque[int] = deque(maxlen=MAX_CLOCK_OFFSETS)
        self._parts: list[Msm7] = []
        self._week: tuple[int, float] | None = None

    def samples(
        self, messages: Iterable[tuple[int, bytes, int | None]]
    ) -> list[tuple[int, Sample]]:
        """Ephemerides and epochs, each with the frame index of the message that completed it.

        Each message comes with the index of the frame that completed it, and with the sender's last
        timestamp before it.
        """
        found: list[tuple[int, Sample]] = []
        for place, message, stamp_us in messages:
            try:
                if message_number(message) in SYSTEMS:
                    found.append((place, self._broadcast(message, stamp_us)))
                elif message_number(message) in MSM7_SYSTEMS:
                    part = decode_msm7(message)
                    # The rest of the previous epoch is missing.
                    if self._parts and self._parts[0].tow_s != part.tow_s:
                        found.append((place, self._epoch(stamp_us)))
                    self._parts.append(part)
                    if not part.more:
                        found.append((place, self._epoch(stamp_us)))
            except ValueError:
                continue  # invalid bytes from a peer give no sample
        return found

    def _broadcast(self, message: bytes, stamp_us: int | None) -> EphemerisSample:
        ephemeris = _ephemeris(message)
        # MSM has no week number; the newest ephemeris gives it.
        self._week = ephemeris.week, ephemeris.toe_s
        return EphemerisSample(stamp_us or 0, ephemeris)

    def _epoch(self, stamp_us: int | None) -> Epoch:
        # Emptied first: the next message begins a new epoch.
        parts, self._parts = self._parts, []
        tow_s = parts[0].tow_s
        week = self._full_week(tow_s)
        gps_us = round((week * WEEK_S + tow_s) * 1e6)
        if stamp_us is not None:
            offset_us = stamp_us - gps_us
            # The jump from week 0 to the true week is not clock drift.
            if self._offsets and abs(offset_us - self._offsets[-1]) > WEEK_S * 1_000_000 // 2:
                self._offsets.clear()  # the week is known from now on
            self._offsets.append(offset_us)
        # The lower median: with an even count it is one of the values, not a mean of two.
        middle = (len(self._offsets) - 1) // 2
        offset_us = sorted(self._offsets)[middle] if self._offsets else 0
        satellites = tuple(name for part in parts for name in part.satellites)
        return Epoch(
            gps_us + offset_us,
            week,
            tow_s,
            satellites,
            np.concatenate([part.pseudorange_m for part in parts]),
            np.concatenate([part.doppler_mps for part in parts]),
            np.concatenate([part.cn0_dbhz for part in parts]),
        )

    def _full_week(self, tow_s: float) -> int:
        """MSM gives no week; the newest ephemeris does (0 before there is one)."""
        if self._week is None:
            return 0
        week, toe_s = self._week
        # Around the week rollover the ephemeris may belong to the adjacent week.
        return week + round((toe_s - tow_s) / WEEK_S)


_ephemeris = lru_cache(EPHEMERIS_CACHE_SIZE)(decode_ephemeris)
