"""Which satellites there are, and which of their ephemerides hold when.

The shipped file knows the satellites one site saw. For a home elsewhere their orbits are turned
about the Earth's axis, and mirrored at the equator for the other hemisphere (ascending node and
argument of perigee half a turn on), so that much the same sky stands over the home. The satellites
are then not where the real ones were, but everything that is broadcast fits them.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rtcm.ephemeris_messages import (
    SEMICIRCLE,
    Ephemeris,
    decode_ephemeris,
    encode_ephemeris,
)
from simvehicle.gnss.gnss_config import GnssConfig
from simvehicle.gnss.navigation_file import (
    SHIPPED,
    WEEK_S,
    NavigationData,
    gps_time,
    read_navigation,
)

SHIPPED_TIME = datetime(2021, 3, 19, 12, 0, 0)
SHIPPED_LON_RAD = math.radians(139.522)  # of the site, 35.339 degrees north
ROTATION_STEP_RAD = SEMICIRCLE / 1024  # the node stays a whole number of the message's counts
SYSTEM_LETTERS = {"GPS": "G", "Galileo": "E"}


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
        """Index of the ephemeris of each satellite at `tow_s`: the present one while it holds.

        A satellite without one that holds has None. `tow_s` counts in `week`.
        """
        return tuple(
            now
            if now is not None and self._age_s(sets[now], tow_s) <= sets[now].fit_half_s
            else self._nearest(sets, tow_s)
            for sets, now in zip(self.ephemerides, present, strict=True)
        )

    def valid_until_s(self, tow_s: float, chosen: Iterable[int | None]) -> float:
        """Until when a choice made at `tow_s` is the right one: one ends, or another comes up."""
        ends = [math.inf]
        for sets, k in zip(self.ephemerides, chosen, strict=True):
            if k is not None:
                ends.append(self._toe_s(sets[k]) + sets[k].fit_half_s)
            else:
                starts = [self._toe_s(e) - e.fit_half_s for e in sets]
                ends += [start for start in starts if start > tow_s]
        return min(ends)

    def _nearest(self, sets: tuple[Ephemeris, ...], tow_s: float) -> int | None:
        ages = [self._age_s(e, tow_s) for e in sets]
        # Of two equally old the later one, as receivers take what was read last.
        best = min(range(len(sets)), key=lambda k: (ages[k], -k))
        return best if ages[best] <= sets[best].fit_half_s else None

    def _age_s(self, ephemeris: Ephemeris, tow_s: float) -> float:
        return abs(tow_s - self._toe_s(ephemeris))

    def _toe_s(self, ephemeris: Ephemeris) -> float:
        return ephemeris.toe_s + (ephemeris.week - self.week) * WEEK_S


def build_constellation(
    config: GnssConfig, home_lat_rad: float, home_lon_rad: float, folder: Path | None = None
) -> Constellation:
    """The constellation of a scenario; `folder` is what a relative file name counts from.

    Raises
    ------
    ConfigError
        If the navigation file is wrong, or none of its satellites is valid at the start.
    """
    path = SHIPPED if config.navigation is None else (folder or Path()) / config.navigation
    navigation = read_navigation(path)
    if config.navigation is None:
        navigation = _rotate_over(navigation, home_lat_rad, home_lon_rad)
    letters = {SYSTEM_LETTERS[system] for system in config.systems}
    ephemerides = {n: sets for n, sets in navigation.ephemerides.items() if n[0] in letters}
    if config.time is not None:
        week, start_s = gps_time(config.time.replace(tzinfo=None))
    elif config.navigation is None:
        week, start_s = gps_time(SHIPPED_TIME)
    else:
        week, start_s = _time_of_most_satellites(ephemerides)
    constellation = Constellation(
        tuple(ephemerides),
        tuple(ephemerides.values()),
        navigation.alpha + navigation.beta,
        week,
        start_s,
    )
    if not any(
        k is not None for k in constellation.choose_ephemerides(start_s, [None] * len(ephemerides))
    ):
        raise ConfigError(
            f"{path}: no satellite of {' and '.join(config.systems)} is valid at "
            f"GPS week {week}, {start_s:.0f} s; a `time` within 2 h (GPS) or 4 h (Galileo) of its "
            "ephemerides"
        )
    return constellation


def _time_of_most_satellites(ephemerides: dict[str, tuple[Ephemeris, ...]]) -> tuple[int, float]:
    """The time of ephemeris at which most satellites have a valid one; the first of several."""
    times = sorted({e.week * WEEK_S + e.toe_s for sets in ephemerides.values() for e in sets})
    if not times:
        return 0, 0.0

    def valid(moment: float) -> int:
        return sum(
            any(abs(moment - e.week * WEEK_S - e.toe_s) <= e.fit_half_s for e in sets)
            for sets in ephemerides.values()
        )

    best = max(times, key=valid)
    return int(best // WEEK_S), best % WEEK_S


def _rotate_over(navigation: NavigationData, lat_rad: float, lon_rad: float) -> NavigationData:
    """The shipped satellites turned over another home."""
    shift_rad = round((lon_rad - SHIPPED_LON_RAD) / ROTATION_STEP_RAD) * ROTATION_STEP_RAD
    mirror = SEMICIRCLE if lat_rad < 0.0 else 0.0
    # Near the site itself nothing is turned, so that the satellites stand where the real ones did.
    if abs(shift_rad) < math.radians(5.0) and not mirror:
        return navigation
    ephemerides = {
        name: tuple(
            # Through the message and back: what is broadcast is exactly what is flown.
            decode_ephemeris(
                encode_ephemeris(
                    replace(
                        e,
                        omega0_rad=e.omega0_rad + shift_rad + mirror,
                        omega_rad=e.omega_rad + mirror,
                    )
                ),
                # The message of GPS carries the week modulo 1024: this is the rollover it counts
                # from.
                e.week // 1024 * 1024,
            )
            for e in sets
        )
        for name, sets in navigation.ephemerides.items()
    }
    return replace(navigation, ephemerides=ephemerides)
