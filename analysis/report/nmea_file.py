"""Write positions as NMEA 0183 sentences (pynmeagps): GGA, RMC, GST, and one GSA per system.

NMEA's altitude is above mean sea level. Without a geoid model the altitude is the ellipsoidal
height and the geoid separation is 0, so that their sum is right.
"""

from collections.abc import Iterable, Iterator
from datetime import datetime, timedelta
from math import atan2, degrees, hypot
from pathlib import Path
from typing import Any

import numpy as np

from analysis.report.solution_row import SolutionRow
from mavproxy_fault.rinex.gps_clock import leap_seconds

# GGA's quality, RMC's status and mode, GSA's mode.
NO_FIX, FIX, DEAD_RECKONED = (0, "V", "N", 1), (1, "A", "A", 3), (6, "A", "E", 1)
# GSA system id, and offset to the RINEX satellite number (NMEA 4.11).
SYSTEMS = {"G": (1, 0), "S": (1, 13), "R": (2, 64), "E": (3, 0), "C": (4, 0), "J": (5, 192)}
MOST_IN_GSA = 12
KNOTS_PER_MPS = 3600.0 / 1852.0


def write_nmea(path: Path, rows: Iterable[SolutionRow]) -> None:
    """Write the sentences of all epochs."""
    from pynmeagps import GET, NMEAMessage

    with path.open("wb") as file:
        for row in rows:
            for kind, fields in _sentences(row):
                # Seven decimals of a minute; the usual five resolve 2 cm.
                file.write(NMEAMessage("GN", kind, GET, hpnmeamode=1, **fields).serialize())


def _sentences(row: SolutionRow) -> Iterator[tuple[str, dict[str, Any]]]:
    """The sentences of an epoch: names, and fields as named by pynmeagps."""
    # NMEA's time and date are UTC; the date may differ from GPS time.
    utc = _utc(row.gps_time)
    quality, status, mode, fix = _quality(row)
    place = {
        "time": utc.time(),
        "lat": row.lat_deg,
        "NS": "N" if row.lat_deg >= 0.0 else "S",
        "lon": row.lon_deg,
        "EW": "E" if row.lon_deg >= 0.0 else "W",
    }
    hdop, vdop = _number(row.hdop, 2), _number(row.vdop, 2)
    yield (
        "GGA",
        place
        | {"quality": quality, "numSV": len(row.satellites), "HDOP": hdop}
        | {"alt": round(row.height_m, 3), "altUnit": "M", "sep": 0.0, "sepUnit": "M"}
        | {"diffAge": "", "diffStation": ""},
    )
    yield (
        "RMC",
        place
        | {"status": status, "posMode": mode, "navStatus": "V", "date": utc.date()}
        | _motion(row)
        | {"mv": "", "mvEW": ""},
    )
    north, east, down = (_number(s, 3) for s in row.sigma_ned_m or (None, None, None))
    ellipse = {"rangeRms": ""} | _ellipse(row)
    yield (
        "GST",
        {"time": utc.time(), "stdLat": north, "stdLong": east, "stdAlt": down} | ellipse,
    )
    pdop = None if row.hdop is None or row.vdop is None else hypot(row.hdop, row.vdop)
    dilution = {"PDOP": _number(pdop, 2), "HDOP": hdop, "VDOP": vdop}
    for system, numbers in _in_use(row.satellites):
        padded = [*numbers, *[""] * (MOST_IN_GSA - len(numbers))]
        slots = {f"svid_{slot:02d}": number for slot, number in enumerate(padded, 1)}
        yield "GSA", {"opMode": "A", "navMode": fix, "systemId": system} | slots | dilution


def _quality(row: SolutionRow) -> tuple[int, str, str, int]:
    """Quality fields; no fix without a sigma, so that readers without GST reject the position."""
    if row.sigma_ned_m is None:
        return NO_FIX
    return FIX if row.satellites else DEAD_RECKONED


def _ellipse(row: SolutionRow) -> dict[str, float | str]:
    """The horizontal error ellipse, its orientation from true north; blank without a covariance."""
    if row.covariance_ned_m2 is None:
        return {"stdMajor": "", "stdMinor": "", "orient": ""}
    (minor, major), axes = np.linalg.eigh(row.covariance_ned_m2[:2, :2])
    orient = round(degrees(atan2(axes[1, 1], axes[0, 1])) % 180.0, 1)
    return {"stdMajor": round(major**0.5, 3), "stdMinor": round(minor**0.5, 3), "orient": orient}


def _motion(row: SolutionRow) -> dict[str, float | str]:
    """Speed and course over ground; blank without a velocity."""
    if row.velocity_ned_mps is None:
        return {"spd": "", "cog": ""}
    north, east, _ = row.velocity_ned_mps
    course = round(degrees(atan2(east, north)) % 360.0, 2)
    return {"spd": round(hypot(north, east) * KNOTS_PER_MPS, 3), "cog": course}


def _in_use(satellites: Iterable[str]) -> Iterator[tuple[int, list[int]]]:
    """Satellite numbers by system, split at the limit of a sentence."""
    numbers: dict[int, list[int]] = {}
    for name in sorted(satellites):
        if name[0] in SYSTEMS:
            system, offset = SYSTEMS[name[0]]
            numbers.setdefault(system, []).append(int(name[1:]) + offset)
    # Further satellites follow in another sentence, as receivers do.
    for system, all_numbers in sorted(numbers.items()):
        for begin in range(0, len(all_numbers), MOST_IN_GSA):
            yield system, all_numbers[begin : begin + MOST_IN_GSA]


def _number(value: float | None, digits: int) -> float | str:
    """A rounded number; blank for None."""
    return "" if value is None else round(value, digits)


def _utc(gps_time: datetime) -> datetime:
    """UTC rounded to 0.01 s, the resolution of pynmeagps, which truncates."""
    utc = gps_time - timedelta(seconds=leap_seconds(gps_time.date()))
    hundredths = round(utc.microsecond * 1e-4)
    return utc.replace(microsecond=0) + timedelta(milliseconds=10 * hundredths)
