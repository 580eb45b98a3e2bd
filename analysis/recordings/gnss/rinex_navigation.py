"""Read RINEX 2, 3 and 4 navigation files: ephemerides and Klobuchar coefficients.

Galileo's I/NAV records are preferred; F/NAV, whose clock belongs to E1 and E5a, serves satellites
that have no other [1]_. GLONASS and BeiDou are read from RINEX 3 and 4 only, with times converted
to GPS time. Of RINEX 4, the record types that RINEX 3 has too are read.

References
----------
.. [1] IGS/RTCM, RINEX 3.05, tables A5, A6, A8, A10, A14; RINEX 4.01, section 8; RINEX 2.11,
   tables A3, A4.
"""

from collections.abc import Iterator
from datetime import date
from pathlib import Path

from analysis.orbits.broadcast import BEIDOU_TIME_OFFSET_S, SYSTEMS, WEEK_S
from analysis.orbits.glonass import leap_seconds
from analysis.recordings.gnss.rinex_observations import gps_time
from analysis.samples.sample import EphemerisSample, IonosphereSample, StateVector
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rinex.navigation_record import (
    ACCURACY,
    DELAY,
    DELAY_B,
    HEALTH,
    IODE,
    SOURCE,
    TOE,
    WEEK,
    orbit_elements,
)
from mavproxy_fault.rinex.rinex_text import header_of, read_rinex_text
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris, l1_health

MESSAGES = ("LNAV", "INAV", "FNAV", "FDMA", "D1", "D2")  # RINEX 4 names the message of each record
BEIDOU_WEEK_ZERO = 1356  # in GPS weeks
FNAV_ONLY = 0b010  # bit 1 of Galileo's data source word: F/NAV on E5a
ACCURACY_INDEX_M = (2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24.0, 48.0, 96.0, 192.0)  # IS-GPS-200N


def read_navigation(path: Path) -> list[EphemerisSample | IonosphereSample]:
    """All usable records of a navigation file in file order, with timestamp 0.

    Raises
    ------
    ConfigError
        If the file is not a RINEX navigation file.
    """
    lines = read_rinex_text(path)
    version, start = header_of(path, lines, "NE", "a navigation file")
    samples: list[EphemerisSample | IonosphereSample] = []
    try:
        samples += _ionosphere(lines[:start])
        samples += _ionosphere_4(lines[start + 1 :])
    except ValueError as error:
        raise ConfigError(f"{path}: an ionosphere field is not a number ({error})") from error
    records = list(_records(lines[start + 1 :], version))
    # Collected first, as records may be in any order.
    with_inav = {e.satellite for e, fnav in records if not fnav}
    for ephemeris, fnav in records:
        if not fnav or ephemeris.satellite not in with_inav:
            samples.append(EphemerisSample(0, ephemeris))
    return samples


def _ionosphere(header: list[str]) -> Iterator[IonosphereSample]:
    found: dict[str, tuple[float, float, float, float]] = {}
    for line in header:
        label = line[60:].strip()
        if label == "IONOSPHERIC CORR" and line[:4] in ("GPSA", "GPSB"):
            found[line[:4].removeprefix("GPS")] = _four(line, 5)
        elif label in ("ION ALPHA", "ION BETA"):
            found[label.removeprefix("ION ")[:1]] = _four(line, 2)
    if len(found) == 2:
        yield IonosphereSample(0, found["A"], found["B"])


def _ionosphere_4(lines: list[str]) -> Iterator[IonosphereSample]:
    """Klobuchar coefficients of RINEX 4 records, which have three, four and one on three lines."""
    for i, line in enumerate(lines):
        if line.startswith("> ION G") and line[10:].split() == ["LNAV"] and i + 3 < len(lines):
            rows = ((lines[i + 1], 1, 4), (lines[i + 2], 0, 4), (lines[i + 3], 0, 1))
            v = [_float(t[4 + 19 * k : 23 + 19 * k]) for t, a, b in rows for k in range(a, b)]
            a0, a1, a2, a3, b0, b1, b2, b3 = v
            yield IonosphereSample(0, (a0, a1, a2, a3), (b0, b1, b2, b3))


def _four(line: str, first: int) -> tuple[float, float, float, float]:
    a, b, c, d = (_float(line[first + 12 * i : first + 12 * i + 12]) for i in range(4))
    return a, b, c, d


def _float(text: str) -> float:
    # Fortran writes double-precision exponents with D.
    text = text.strip().replace("D", "E").replace("d", "e")
    return float(text) if text else 0.0


def _records(lines: list[str], version: float) -> Iterator[tuple[Ephemeris | StateVector, bool]]:
    """Each ephemeris, and whether it is a Galileo F/NAV one."""
    indent = 3 if version < 3.0 else 4
    at, readable = 0, True
    while at < len(lines):
        line = lines[at]
        at += 1
        if line.startswith(">"):
            readable = line.startswith("> EPH") and line[10:].strip() in MESSAGES
            continue
        if version < 3.0:
            name = "G" + line[:2].replace(" ", "0")
            known = line[:2].strip().isdigit()
        else:
            name = line[:1] + line[1:3].replace(" ", "0")
            known = line[:1] in SYSTEMS and name[1:].isdigit() and line[4:8].isdigit()
        count = 3 if name[0] == "R" else 7
        if not (known and readable) or at + count > len(lines):
            continue
        body = lines[at : at + count]
        try:
            if name[0] == "R":
                yield _state_vector(name, line, body), False
            else:
                yield _ephemeris(name, line, body, indent)
        # Skip a corrupted record line by line, up to the next satellite name.
        except ValueError:
            continue
        at += count


def _ephemeris(name: str, head: str, body: list[str], indent: int) -> tuple[Ephemeris, bool]:
    start = indent + 19
    parts = head[3 if indent == 3 else 4 : start].split()
    year = int(parts[0])
    if indent == 3:
        # GPS time began in 1980: 80 to 99 are 1980 to 1999.
        year += 1900 if year >= 80 else 2000
    *fields, second = parts[1:]
    month, day, hour, minute = (int(p) for p in fields)
    toc = gps_time(year, month, day, hour * 3600 + minute * 60 + float(second))
    af0, af1, af2 = (_float(head[start + 19 * i : start + 19 * i + 19]) for i in range(3))
    v = [_float(line[indent + 19 * i : indent + 19 * i + 19]) for line in body for i in range(4)]
    galileo, lnav = name[0] == "E", name[0] in "GJ"
    week, toe_s = int(v[WEEK]), v[TOE]
    # BeiDou time is 14 s behind GPS time and counts weeks from 2006.
    if name[0] == "C":
        week, toe_s = _time_later(week + BEIDOU_WEEK_ZERO, toe_s, BEIDOU_TIME_OFFSET_S)
        toc = _time_later(*toc, BEIDOU_TIME_OFFSET_S)
    fnav = galileo and bool(int(v[SOURCE]) & FNAV_ONLY)
    delay = (v[DELAY] if fnav else v[DELAY_B]) if galileo else v[DELAY]
    ephemeris = Ephemeris(
        satellite=name,
        week=week,
        toe_s=toe_s,
        toc_s=toc[1],
        af0_s=af0,
        af1=af1,
        af2_per_s=af2,
        iode=int(v[IODE]),
        iodc=int(v[DELAY_B]) if lnav else int(v[IODE]),
        **orbit_elements(v),
        group_delay_s=delay,
        group_delay_e5a_s=v[DELAY] if galileo else 0.0,
        accuracy=sum(v[ACCURACY] > limit for limit in ACCURACY_INDEX_M) if lnav else 0,
        health=l1_health(name, int(v[HEALTH])),
    )
    return ephemeris, fnav


def _time_later(week: int, tow_s: float, by_s: float) -> tuple[int, float]:
    """Week and time of week, `by_s` seconds later."""
    weeks, tow_s = divmod(tow_s + by_s, WEEK_S)
    return week + int(weeks), tow_s


def _state_vector(name: str, head: str, body: list[str]) -> StateVector:
    """A GLONASS record; its time is UTC, its lengths are in km."""
    year, month, day, hour, minute, second = (int(part) for part in head[4:23].split())
    utc = gps_time(year, month, day, hour * 3600 + minute * 60 + second)
    week, toe_s = _time_later(*utc, leap_seconds(date(year, month, day)))
    rows = [[_float(line[4 + 19 * i : 23 + 19 * i]) for i in range(4)] for line in body]
    # One line per axis: position, velocity, acceleration; the first line ends with the health.
    r, v, a = (tuple(1000.0 * row[i] for row in rows) for i in range(3))
    return StateVector(
        satellite=name,
        week=week,
        toe_s=toe_s,
        r_m=(r[0], r[1], r[2]),
        v_mps=(v[0], v[1], v[2]),
        a_mps2=(a[0], a[1], a[2]),
        af0_s=_float(head[23:42]),
        af1=_float(head[42:61]),
        health=int(rows[0][-1]),
    )
