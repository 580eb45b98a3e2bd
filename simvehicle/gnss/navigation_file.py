"""RINEX 3 navigation files: GPS LNAV and Galileo I/NAV ephemerides and Klobuchar coefficients.

Records of other systems are skipped, and so is Galileo's F/NAV, whose clock is for E1/E5a. The
columns are those of RINEX 3.05, tables A5 (header), A6 (GPS) and A8 (Galileo).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rinex.navigation_record import (
    ACCURACY,
    DELAY,
    DELAY_B,
    FIT,
    HEALTH,
    IODE,
    L2P,
    SOURCE,
    TOE,
    WEEK,
    orbit_elements,
)
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris, decode_ephemeris, encode_ephemeris

SHIPPED = Path(__file__).with_name("constellation.nav")

GPS_EPOCH = datetime(1980, 1, 6)
WEEK_S = 604_800.0
INAV_CLOCK = 1 << 9  # data sources, bit 9: af0 to af2, toc and SISA are for E5b, E1
UNKNOWN_SISA = 255
RECORD_LINES = {"R": 4, "S": 4}  # lines of a record; 8 for every other system
# IS-GPS-200N 20.3.3.3.1.3: upper limits of the user range accuracy, index 0 to 14
URA_M = (2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24, 48, 96, 192, 384, 768, 1536, 3072, 6144)


@dataclass(frozen=True, slots=True)
class NavigationData:
    """Content of a navigation file; each satellite's ephemerides are in order of `toe`.

    `alpha`, `beta` are the Klobuchar coefficients in s, s/semicircle, ... (four each), all zero if
    the file has none.
    """

    ephemerides: dict[str, tuple[Ephemeris, ...]]
    alpha: tuple[float, ...]
    beta: tuple[float, ...]


def gps_time(time: datetime) -> tuple[int, float]:
    """GPS week and seconds of week of a time in the GPS scale."""
    seconds = (time - GPS_EPOCH) / timedelta(seconds=1)
    week = int(seconds // WEEK_S)
    return week, seconds - week * WEEK_S


def read_navigation(path: Path) -> NavigationData:
    """Read the navigation file at `path`.

    Ephemerides are rounded to the resolution of their RTCM messages, so that the simulator uses
    exactly the broadcast values.

    Raises
    ------
    ConfigError
        If it is not a RINEX 3 navigation file, a record is invalid, or it has no ephemeris of a
        healthy GPS or Galileo satellite.
    """
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}); give a RINEX 3 file") from error
    return parse_navigation(lines, str(path))


def parse_navigation(lines: list[str], where: str) -> NavigationData:
    """Parse the lines of a navigation file; `where` names it in errors (see `read_navigation`)."""
    end, alpha, beta = _header(lines, where)
    by_time: dict[str, dict[float, Ephemeris]] = {}
    for number, record in _records(lines, end, where):
        ephemeris = _ephemeris(record, number, where)
        if ephemeris is not None and ephemeris.health == 0:
            time_s = ephemeris.week * WEEK_S + ephemeris.toe_s
            # Of two with the same time of ephemeris, the later one in the file is kept.
            by_time.setdefault(ephemeris.satellite, {})[time_s] = ephemeris
    if not by_time:
        raise ConfigError(
            f"{where}: has no ephemeris of a healthy GPS or Galileo (I/NAV) satellite; "
            "at least one is needed, better one for each satellite in view"
        )
    ephemerides = {n: tuple(e for _, e in sorted(by_time[n].items())) for n in sorted(by_time)}
    return NavigationData(ephemerides, alpha, beta)


def _header(lines: list[str], where: str) -> tuple[int, tuple[float, ...], tuple[float, ...]]:
    """Index of the first line after the header, alpha and beta."""
    first = lines[0] if lines else ""
    if first[60:80].strip() != "RINEX VERSION / TYPE" or first[20:21] != "N":
        raise ConfigError(f"{where}:1: is not a RINEX navigation file; RINEX 3, type N, is needed")
    if first[:9].strip()[:2] != "3.":
        raise ConfigError(
            f"{where}:1: RINEX {first[:9].strip()} is not supported; use 3.00 to 3.05"
        )
    coefficients: dict[str, tuple[float, ...]] = {label: (0.0,) * 4 for label in ("GPSA", "GPSB")}
    for i, line in enumerate(lines):
        label = line[60:80].strip()
        if label == "END OF HEADER":
            return i + 1, coefficients["GPSA"], coefficients["GPSB"]
        if label == "IONOSPHERIC CORR" and line[:4] in coefficients:
            coefficients[line[:4]] = tuple(
                _number(line[5 + 12 * k : 17 + 12 * k], i + 1, where) for k in range(4)
            )
    raise ConfigError(f"{where}:{len(lines)}: the header has no end; END OF HEADER is needed")


def _records(lines: list[str], start: int, where: str) -> Iterator[tuple[int, list[str]]]:
    """Line numbers (from 1) and lines of the GPS and Galileo records."""
    at = start
    while at < len(lines):
        system = lines[at][:1]
        if not lines[at].strip():
            at += 1
            continue
        if not system.isalpha():
            raise ConfigError(
                f"{where}:{at + 1}: {lines[at][:23]!r} does not start a record; "
                "a satellite such as G12 and a time are needed"
            )
        count = RECORD_LINES.get(system, 8)
        record = lines[at : at + count]
        cut = next((i for i, line in enumerate(record[1:], 1) if line[:1].strip()), len(record))
        if cut < count:
            raise ConfigError(
                f"{where}:{at + 1 + cut}: the record of {record[0][:3]} ends after {cut} lines; "
                f"{count} lines are needed"
            )
        if system in "GE":
            yield at + 1, record
        at += count


def _ephemeris(record: list[str], line: int, where: str) -> Ephemeris | None:
    """The ephemeris of one record; None for Galileo's F/NAV."""
    # Some writers put "G 1" for G01.
    name = record[0][:3].replace(" ", "0")
    toc_s = _clock_time(record[0][4:23], line, where)
    clock = [_number(record[0][23 + 19 * k : 42 + 19 * k], line, where) for k in range(3)]
    v = [
        _number(text[4 + 19 * k : 23 + 19 * k], line + i, where)
        for i, text in enumerate(record[1:], 1)
        for k in range(4)
    ]
    galileo = name[0] == "E"
    if galileo and v[SOURCE] and not int(v[SOURCE]) & INAV_CLOCK:
        return None
    ephemeris = Ephemeris(
        satellite=name,
        week=int(v[WEEK]),
        toe_s=v[TOE],
        toc_s=toc_s,
        af0_s=clock[0],
        af1=clock[1],
        af2_per_s=clock[2],
        iode=int(v[IODE]),
        iodc=int(v[IODE]) if galileo else int(v[DELAY_B]),
        **orbit_elements(v),
        group_delay_s=v[DELAY_B] if galileo else v[DELAY],
        group_delay_e5a_s=v[DELAY] if galileo else 0.0,
        accuracy=sisa_index(v[ACCURACY]) if galileo else ura_index(v[ACCURACY]),
        health=_galileo_health(int(v[HEALTH])) if galileo else int(v[HEALTH]),
        codes=(0, 0) if galileo else (int(v[SOURCE]), int(v[L2P])),
        long_fit=not galileo and v[FIT] > 4.0,
    )
    try:
        return decode_ephemeris(encode_ephemeris(ephemeris), ephemeris.week // 1024 * 1024)
    except ValueError as error:
        raise ConfigError(
            f"{where}:{line}: the record of {name} cannot be broadcast ({error}); "
            "all values must fit the navigation message"
        ) from error


def _clock_time(text: str, line: int, where: str) -> float:
    """Seconds of week of the clock's reference time."""
    try:
        return gps_time(datetime(*(int(part) for part in text.split())))[1]  # type: ignore[arg-type]
    except (ValueError, TypeError) as error:
        raise ConfigError(
            f"{where}:{line}: {text.strip()!r} is not a time; use year month day hour minute second"
        ) from error


def _number(text: str, line: int, where: str) -> float:
    """A number in FORTRAN notation; blank is zero."""
    try:
        value = float(text.replace("D", "E").replace("d", "e")) if text.strip() else 0.0
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(
            f"{where}:{line}: {text.strip()!r} is not a number like -.123456789012D-03"
        )
    return value


def ura_index(accuracy_m: float) -> int:
    """The GPS index of a user range accuracy in metres; 15 if none is predicted."""
    return next((i for i, limit in enumerate(URA_M) if accuracy_m <= limit), 15)


def sisa_index(accuracy_m: float) -> int:
    """The Galileo index of a signal-in-space accuracy (OS SIS ICD table 91); 255 if none."""
    for start, first, step in ((0.0, 0, 0.01), (0.5, 50, 0.02), (1.0, 75, 0.04), (2.0, 100, 0.16)):
        index = first + round((accuracy_m - start) / step)
        if accuracy_m >= start and index < {0: 50, 50: 75, 75: 100, 100: 126}[first]:
            return index
    return UNKNOWN_SISA


def _galileo_health(bits: int) -> int:
    """The RINEX health word (bits 6 to 8: E5b, 0 to 2: E1B) in the encoding of RTCM 1046."""

    def status_and_validity(word: int) -> int:
        return (word >> 1 & 3) << 1 | word & 1

    return status_and_validity(bits >> 6) << 3 | status_and_validity(bits)
