"""Assemble the RTCM messages of one stream to ephemerides and pseudorange epochs."""

from collections import deque
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from analysis.samples.block import Indices
from analysis.samples.sample import EphemerisSample, Epoch, Sample, Vector
from mavproxy_fault.rtcm.ephemeris_messages import SYSTEMS, decode_ephemeris
from mavproxy_fault.rtcm.range_columns import NAMES, NO_MSM7, read_ranges
from mavproxy_fault.rtcm.tunnel_columns import Messages

HALF_WEEK_S = 302_400.0
WEEK_S = 604_800
MAX_CLOCK_OFFSETS = 25  # chosen: the median ignores up to 12 late frames
EPHEMERIS_CACHE_SIZE = 512  # satellites repeat an ephemeris for hours


class RangeRows(NamedTuple):
    """Observations of satellites (n,); `code` numbers the satellite (see `rtcm.range_columns`)."""

    code: Indices
    pseudorange_m: Vector
    doppler_mps: Vector
    cn0_dbhz: Vector

    def slice_rows(self, begin: int, end: int) -> "RangeRows":
        """The rows from `begin` to before `end`."""
        at = slice(begin, end)
        return RangeRows(
            self.code[at], self.pseudorange_m[at], self.doppler_mps[at], self.cn0_dbhz[at]
        )

    def append_to(self, rows: "RangeRows") -> "RangeRows":
        """These rows (n,) appended to others (m,)."""
        return RangeRows(
            np.concatenate([rows.code, self.code]),
            np.concatenate([rows.pseudorange_m, self.pseudorange_m]),
            np.concatenate([rows.doppler_mps, self.doppler_mps]),
            np.concatenate([rows.cn0_dbhz, self.cn0_dbhz]),
        )


NO_ROWS = RangeRows(np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0))


class EpochAssembler:
    """Assembles epochs; keeps the incomplete epoch, the GPS week and the clock offset.

    TUNNEL frames have no timestamp, so the timestamp of a pseudorange epoch is its GPS time plus
    the median of the latest differences between the sender's clock and GPS time. The median makes
    it robust to late frames and gaps in the sender's timestamped messages.
    """

    def __init__(self) -> None:
        self._offsets: deque[int] = deque(maxlen=MAX_CLOCK_OFFSETS)
        self._tow_ms, self._rows = NO_MSM7, NO_ROWS
        self._week: tuple[int, float] | None = None

    def samples(
        self, messages: Messages, places: list[int], stamps_us: list[int | None]
    ) -> list[tuple[int, Sample]]:
        """Ephemerides and epochs, each with the frame index of the message that completed it.

        `stamps_us` (k) are the sender's last timestamps before each message.
        """
        ranges = read_ranges(messages)
        # The rows of an incomplete epoch precede the new ones.
        rows = RangeRows(*ranges[3:]).append_to(self._rows)
        begin, end = 0, len(self._rows.code)
        heads = zip(
            messages.number.tolist(),
            ranges.tow_ms.tolist(),
            ranges.more.tolist(),
            (ranges.ends + end).tolist(),
            places,
            stamps_us,
            strict=True,
        )
        found: list[tuple[int, Sample]] = []
        for i, (number, tow_ms, more, last, place, stamp_us) in enumerate(heads):
            if number in SYSTEMS:
                found += [(place, s) for s in self._broadcast(messages.bytes(i), stamp_us)]
            # No pseudoranges: an ephemeris or another RTCM message.
            if tow_ms == NO_MSM7:
                continue
            if self._tow_ms not in (NO_MSM7, tow_ms):  # the rest of the previous epoch is missing
                found.append((place, self._epoch(rows.slice_rows(begin, end), stamp_us)))
                begin = end
            self._tow_ms, end = tow_ms, last
            if not more:
                found.append((place, self._epoch(rows.slice_rows(begin, end), stamp_us)))
                begin = end
        self._rows = rows.slice_rows(begin, end).append_to(NO_ROWS)  # a copy
        return found

    def _broadcast(self, message: bytes, stamp_us: int | None) -> list[Sample]:
        try:
            ephemeris = _ephemeris(message)
        except ValueError:  # invalid bytes from a peer give no sample
            return []
        # MSM has no week number; the newest ephemeris gives it.
        self._week = ephemeris.week, ephemeris.toe_s
        return [EphemerisSample(stamp_us or 0, ephemeris)]

    def _epoch(self, rows: RangeRows, stamp_us: int | None) -> Epoch:
        # Reset first: the next message begins a new epoch.
        tow_s, self._tow_ms = self._tow_ms / 1000.0, NO_MSM7
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
        satellites = _satellites(rows.code.tobytes())
        return Epoch(gps_us + offset_us, week, tow_s, satellites, *rows[1:])

    def _full_week(self, tow_s: float) -> int:
        """MSM gives no week; the newest ephemeris does (0 before there is one)."""
        if self._week is None:
            return 0
        week, toe_s = self._week
        # Around the week rollover the ephemeris may belong to the adjacent week.
        if tow_s - toe_s > HALF_WEEK_S:
            return week - 1
        return week + 1 if toe_s - tow_s > HALF_WEEK_S else week


_ephemeris = lru_cache(EPHEMERIS_CACHE_SIZE)(decode_ephemeris)


# Keyed by bytes, since arrays are not hashable.
@lru_cache(256)
def _satellites(codes: bytes) -> tuple[str, ...]:
    """Names of satellites; cached, as consecutive epochs share them."""
    return tuple(NAMES[code] for code in np.frombuffer(codes, np.int64).tolist())
