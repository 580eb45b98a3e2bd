"""The satellites of a scenario, and which of their ephemerides are valid when.

The shipped file has the satellites in view of one site. For a home elsewhere the orbits are rotated
about the Earth's axis, and mirrored at the equator for the other hemisphere (ascending node and
argument of perigee plus half a turn), which gives much the same sky view. The satellites are then
not where the real ones were, but their broadcast ephemerides describe them exactly.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rinex.gps_clock import WEEK_S, gps_time
from mavproxy_fault.rinex.navigation_record import kepler_ephemeris, read_navigation_file
from mavproxy_fault.rtcm.ephemeris_messages import (
    SEMICIRCLE,
    Ephemeris,
    decode_ephemeris,
    encode_ephemeris,
)
from simvehicle.gnss.gnss_config import GnssConfig

SHIPPED = Path(__file__).with_name("constellation.nav")
SHIPPED_TIME = datetime(2021, 3, 19, 12, 0, 0)
SHIPPED_LON_RAD = math.radians(139.522)  # of the site, which is 35.339 degrees north
ROTATION_STEP_RAD = SEMICIRCLE / 1024  # the node stays an integer in the message
SYSTEM_LETTERS = {"GPS": "G", "Galileo": "E"}
Ephemerides = dict[str, tuple[Ephemeris, ...]]  # by satellite, in order of `toe`


@dataclass(frozen=True, slots=True)
class Constellation:
    """Satellites with their ephemerides, and the GPS time of the simulation's start."""

    satellites: tuple[str, ...]
    ephemerides: tuple[tuple[Ephemeris, ...], ...]
    klobuchar: tuple[float, ...]
    week: int
    start_s: float

    def choose_ephemerides(
        self, tow_s: float, present: Iterable[int | None]
    ) -> tuple[int | None, ...]:
        """Index of each satellite's ephemeris at `tow_s`: the present one while it is valid.

        A satellite without a valid ephemeris has None. `tow_s` counts from the start of `week`.
        """
        return tuple(
            k if k is not None and self._is_valid(sets[k], tow_s) else self._nearest(sets, tow_s)
            for sets, k in zip(self.ephemerides, present, strict=True)
        )

    def valid_until_s(self, tow_s: float, chosen: Iterable[int | None]) -> float:
        """When a choice made at `tow_s` expires: an ephemeris ends, or another becomes valid."""
        ends = [math.inf]
        for sets, k in zip(self.ephemerides, chosen, strict=True):
            if k is not None:
                ends.append(self._toe_s(sets[k]) + sets[k].fit_half_s)
            else:
                starts = [self._toe_s(e) - e.fit_half_s for e in sets]
                ends += [start for start in starts if start > tow_s]
        return min(ends)

    def _nearest(self, sets: tuple[Ephemeris, ...], tow_s: float) -> int | None:
        # Of two equally old ones the later, as receivers use the last one read.
        best = min(range(len(sets)), key=lambda k: (abs(tow_s - self._toe_s(sets[k])), -k))
        return best if self._is_valid(sets[best], tow_s) else None

    def _is_valid(self, ephemeris: Ephemeris, tow_s: float) -> bool:
        return abs(tow_s - self._toe_s(ephemeris)) <= ephemeris.fit_half_s

    def _toe_s(self, ephemeris: Ephemeris) -> float:
        return ephemeris.toe_s + (ephemeris.week - self.week) * WEEK_S


def as_broadcast(ephemeris: Ephemeris) -> Ephemeris:
    """The ephemeris with the resolution of its message, so that simulated and broadcast orbit are
    the same; ValueError if it does not fit."""
    # The GPS message has the week modulo 1024: this is the last rollover.
    return decode_ephemeris(encode_ephemeris(ephemeris), ephemeris.week // 1024 * 1024)


def read_navigation(path: Path) -> tuple[Ephemerides, tuple[float, ...]]:
    """The satellites of the navigation file at `path` that the simulator can broadcast, and
    Klobuchar's coefficients (8,), all zero if it has none.

    These are the healthy ones of GPS (LNAV) and Galileo (I/NAV); other records are skipped, and so
    is Galileo's F/NAV, whose clock is for E1 and E5a. Ephemerides are rounded to the resolution of
    their RTCM messages, so that the simulator uses exactly the broadcast values; one that does not
    fit its message is skipped.

    Raises
    ------
    ConfigError
        If it is not a RINEX navigation file, or has no ephemeris of a healthy GPS or Galileo
        satellite.
    """
    records, klobuchar = read_navigation_file(path)
    by_time: dict[str, dict[float, Ephemeris]] = {}
    for record in records:
        if record.satellite[0] not in "GE" or record.is_fnav:
            continue
        try:
            ephemeris = as_broadcast(kepler_ephemeris(record))
        except ValueError:
            continue
        if ephemeris.health == 0:
            time_s = ephemeris.week * WEEK_S + ephemeris.toe_s
            # Of two with the same time of ephemeris, the later one in the file is kept.
            by_time.setdefault(ephemeris.satellite, {})[time_s] = ephemeris
    if not by_time:
        raise ConfigError(
            f"{path}: has no ephemeris of a healthy GPS or Galileo (I/NAV) satellite; "
            "at least one is needed, better one for each satellite in view"
        )
    ephemerides = {n: tuple(e for _, e in sorted(by_time[n].items())) for n in sorted(by_time)}
    alpha, beta = klobuchar or ((0.0,) * 4,) * 2
    return ephemerides, (*alpha, *beta)


def build_constellation(
    config: GnssConfig, home_lat_rad: float, home_lon_rad: float
) -> Constellation:
    """Build the constellation of a scenario.

    Raises
    ------
    ConfigError
        If the navigation file is invalid, or has no valid ephemeris at the start.
    """
    path = SHIPPED if config.navigation is None else Path(config.navigation)
    known, klobuchar = read_navigation(path)
    if config.navigation is None:
        known = _rotate_over(known, home_lat_rad, home_lon_rad)
    letters = {SYSTEM_LETTERS[system] for system in config.systems}
    ephemerides = {n: sets for n, sets in known.items() if n[0] in letters}
    week, start_s = _time_of_most_satellites(ephemerides)
    time = config.time or (SHIPPED_TIME if config.navigation is None else None)
    if time is not None:
        midnight = time.replace(hour=0, minute=0, second=0, microsecond=0)
        seconds = (time - midnight).total_seconds()
        week, start_s = gps_time(time.year, time.month, time.day, seconds)
    names, sets = tuple(ephemerides), tuple(ephemerides.values())
    constellation = Constellation(names, sets, klobuchar, week, start_s)
    if set(constellation.choose_ephemerides(start_s, [None] * len(sets))) <= {None}:
        raise ConfigError(
            f"{path}: no satellite of {' and '.join(config.systems)} is valid at "
            f"GPS week {week}, {start_s:.0f} s; set `time` within 2 h (GPS) or 4 h (Galileo) of "
            "its ephemerides"
        )
    return constellation


def _time_of_most_satellites(ephemerides: Ephemerides) -> tuple[int, float]:
    """The first time of ephemeris (week, s) at which the most satellites have a valid one."""
    times = sorted({e.week * WEEK_S + e.toe_s for sets in ephemerides.values() for e in sets})
    if not times:
        return 0, 0.0

    def count_valid(time_s: float) -> int:
        return sum(
            any(abs(time_s - e.week * WEEK_S - e.toe_s) <= e.fit_half_s for e in sets)
            for sets in ephemerides.values()
        )

    best = max(times, key=count_valid)
    return int(best // WEEK_S), best % WEEK_S


def _rotate_over(shipped: Ephemerides, lat_rad: float, lon_rad: float) -> Ephemerides:
    """Rotate the shipped satellites over another home."""
    shift_rad = round((lon_rad - SHIPPED_LON_RAD) / ROTATION_STEP_RAD) * ROTATION_STEP_RAD
    mirror = SEMICIRCLE if lat_rad < 0.0 else 0.0
    # Near the site nothing is rotated, so that the satellites are where the real ones were.
    if abs(shift_rad) < math.radians(5.0) and not mirror:
        return shipped
    return {
        name: tuple(
            as_broadcast(
                replace(
                    e,
                    omega0_rad=e.omega0_rad + shift_rad + mirror,
                    omega_rad=e.omega_rad + mirror,
                )
            )
            for e in sets
        )
        for name, sets in shipped.items()
    }
