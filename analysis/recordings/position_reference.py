"""True position of an antenna: a point, an RTKLIB position file, or a table of positions.

Heights are above the ellipsoid, times GPS time.
"""

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.sample import Vector
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.earth import ecef_from_geodetic

WEEK_S = 604_800
NEAREST_RADIUS_M = 1e5  # larger coordinates are ECEF metres, smaller ones degrees
MAX_GAP_US = 2_000_000  # longest gap between two positions that is interpolated
SAME_EPOCH_US = 20_000
GPS_ZERO = datetime(1980, 1, 6, tzinfo=UTC)
CALENDAR = re.compile(r"\d{4}/\d\d/\d\d ")
FORMS = (
    "a point X,Y,Z in m or LAT,LON,HEIGHT in degrees and m, RTKLIB's .pos in GPST, or a CSV of"
    " week, tow_s, lat_deg, lon_deg, height_m"
)


class PositionReference(NamedTuple):
    """Timestamps (n,) in us since the start of GPS time and ECEF positions (n, 3); a single
    position is valid at all times."""

    t_us: NDArray[np.int64]
    r_ecef_m: Vector

    def at(self, t_us: int) -> list[float] | None:
        """The position (3,) at a time, linearly interpolated; None if unknown."""
        if len(self.t_us) == 1:
            still: list[float] = self.r_ecef_m[0].tolist()
            return still
        after = int(np.searchsorted(self.t_us, t_us))
        ends = [i for i in (after - 1, after) if 0 <= i < len(self.t_us)]
        nearest = min(ends, key=lambda i: abs(int(self.t_us[i]) - t_us))
        if abs(int(self.t_us[nearest]) - t_us) > SAME_EPOCH_US:
            if len(ends) < 2 or self.t_us[after] - self.t_us[after - 1] > MAX_GAP_US:
                return None
            share = (t_us - self.t_us[after - 1]) / (self.t_us[after] - self.t_us[after - 1])
            between = (1.0 - share) * self.r_ecef_m[after - 1] + share * self.r_ecef_m[after]
            return [float(x) for x in between]
        place: list[float] = self.r_ecef_m[nearest].tolist()
        return place


def read_reference(given: str) -> PositionReference:
    """Read a reference, given on the command line as a point or the path of a file.

    Raises
    ------
    ConfigError
        If it has none of the supported forms.
    """
    point = _numbers(given.split(","))
    if point is not None and len(point) == 3:
        return PositionReference(np.zeros(1, np.int64), _place(point, "--truth")[None])
    path = Path(given)
    try:
        # Spreadsheets write a byte order mark before UTF-8.
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"--truth {given}: cannot be read as text ({error}); {FORMS}") from error
    heads = [line for line in lines if line.startswith("%")]
    # RTKLIB names the time scale above the columns; UTC differs by the leap seconds.
    if any(re.match(r"%\s+UTC", line) for line in heads):
        raise ConfigError(f"--truth {given}: its times are UTC; write it in GPST")
    rows = [row for line in lines if (row := _row(line, given)) is not None]
    if not rows:
        raise ConfigError(f"--truth {given}: has no position; {FORMS}")
    # `at` searches by time; concatenated files need not be in order.
    rows.sort(key=lambda row: row[0])
    table = np.array([row[1] for row in rows])
    return PositionReference(np.array([row[0] for row in rows]), table)


def _row(line: str, given: str) -> tuple[int, Vector] | None:
    """Timestamp and position of a line; None for a comment, a heading or an empty line."""
    if not line.strip() or line.startswith(("%", "#")):
        return None
    if CALENDAR.match(line):
        day, clock, *rest = line.split()
        since = datetime.strptime(f"{day} {clock}", "%Y/%m/%d %H:%M:%S.%f").replace(tzinfo=UTC)
        delta = since - GPS_ZERO
        stamp_us = (delta.days * 86_400 + delta.seconds) * 1_000_000 + delta.microseconds
        values = _numbers(rest[:3])
    else:
        numbers = _numbers((line.split(",") if "," in line else line.split())[:5])
        if numbers is None and line.lstrip()[:1].isalpha():
            return None
        if numbers is None or len(numbers) < 5:
            raise ConfigError(f"--truth {given}: {line[:40]!r} cannot be read; {FORMS}")
        stamp_us = round((numbers[0] * WEEK_S + numbers[1]) * 1e6)
        values = numbers[2:]
    if values is None or len(values) < 3:
        raise ConfigError(f"--truth {given}: {line[:40]!r} has no position; {FORMS}")
    return stamp_us, _place(values, f"--truth {given}")


def _numbers(words: list[str]) -> list[float] | None:
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def _place(values: list[float], where: str) -> Vector:
    """ECEF position (3,) from ECEF metres, or from degrees and height."""
    if max(map(abs, values)) > NEAREST_RADIUS_M:
        return np.array(values)
    lat_deg, lon_deg, height_m = values
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 360.0):
        raise ConfigError(f"{where}: {lat_deg}, {lon_deg} is not latitude, longitude in degrees")
    place: Vector = ecef_from_geodetic(np.radians(lat_deg), np.radians(lon_deg), height_m)
    return place
