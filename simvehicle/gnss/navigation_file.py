"""The satellites of a RINEX navigation file that the simulator can broadcast.

These are the healthy ones of GPS (LNAV) and Galileo (I/NAV); other records are skipped, and so is
Galileo's F/NAV, whose clock is for E1 and E5a.
"""

from dataclasses import dataclass
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rinex.gps_clock import WEEK_S
from mavproxy_fault.rinex.navigation_record import kepler_ephemeris, read_navigation_file
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris, decode_ephemeris, encode_ephemeris

SHIPPED = Path(__file__).with_name("constellation.nav")


@dataclass(frozen=True, slots=True)
class NavigationData:
    """Content of a navigation file; each satellite's ephemerides are in order of `toe`.

    `alpha`, `beta` are the Klobuchar coefficients in s, s/semicircle, ... (four each), all zero if
    the file has none.
    """

    ephemerides: dict[str, tuple[Ephemeris, ...]]
    alpha: tuple[float, ...]
    beta: tuple[float, ...]


def as_broadcast(ephemeris: Ephemeris) -> Ephemeris:
    """The ephemeris with the resolution of its message, so that simulated and broadcast orbit are
    the same; ValueError if it does not fit."""
    # The GPS message has the week modulo 1024: this is the last rollover.
    return decode_ephemeris(encode_ephemeris(ephemeris), ephemeris.week // 1024 * 1024)


def read_navigation(path: Path) -> NavigationData:
    """Read the navigation file at `path`.

    Ephemerides are rounded to the resolution of their RTCM messages, so that the simulator uses
    exactly the broadcast values; one that does not fit its message is skipped.

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
    return NavigationData(ephemerides, *(klobuchar or ((0.0,) * 4,) * 2))
