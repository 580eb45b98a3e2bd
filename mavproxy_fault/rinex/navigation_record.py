"""Reads RINEX 2, 3 and 4 navigation files: broadcast ephemerides and Klobuchar coefficients.

Times are converted to GPS time. The week is that in which the time of ephemeris is nearest to the
clock's reference time, since files write the week of either or that of transmission. A damaged
record is skipped; spare fields are not read. Of RINEX 4, the records that RINEX 3 has too are read
[1]_.

References
----------
.. [1] IGS/RTCM, RINEX 3.05, tables A5, A6 (GPS), A8 (Galileo), A10 (GLONASS), A14 (BeiDou);
   RINEX 4.01, section 8; RINEX 2.11, tables A3, A4, A10, A11.
.. [2] IS-GPS-200N, 20.3.3.3.1.3; Galileo OS SIS ICD 2.1, table 91.
"""

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rinex.gps_clock import BEIDOU_OFFSET_S, WEEK_S, normalized, time_of_words
from mavproxy_fault.rinex.rinex_text import check_header, read_rinex_text
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris, ephemeris_of

# Four per line, with the names of `Ephemeris`. "delay" is T_GD, BGD(E1,E5a) or BeiDou's T_GD1;
# "delay_b" is Galileo's BGD(E1,E5b), for GPS the IODC; "code" is Galileo's data source, for GPS the
# codes on L2; "fit" is the interval [h] of GPS.
NUMBERS = (
    "iode", "crs_m", "delta_n_rps", "m0_rad",
    "cuc_rad", "eccentricity", "cus_rad", "sqrt_a",
    "toe_s", "cic_rad", "omega0_rad", "cis_rad",
    "i0_rad", "crc_m", "omega_rad", "omega_dot_rps",
    "idot_rps", "code", "week", "l2p",
    "accuracy", "health", "delay", "delay_b",
    "sent", "fit",
)  # fmt: skip
SOURCE, WEEK, L2P, DELAY_B = map(NUMBERS.index, ("code", "week", "l2p", "delay_b"))
# Unused fields by system, which may be blank or damaged.
UNUSED = {"G": {WEEK}, "J": {WEEK, L2P}, "E": {WEEK, L2P}, "C": {SOURCE, WEEK, L2P, DELAY_B}}
MESSAGES = ("LNAV", "INAV", "FNAV", "FDMA", "D1", "D2")  # RINEX 4 names the message of each record
KINDS = "NGELJC"  # types of navigation files; RINEX 2 has one of each system
SYSTEM_2 = {"N": "G", "G": "R", "L": "E"}  # the system of the types that differ
CLOCKS = {"R": "UTC", "C": "BDT"}  # time systems other than GPS time
BODY_LINES = {"R": 3}  # lines after the first; 7 of other systems, the last one may be missing
HEAD_2 = re.compile(r"[ \d]\d [ \d]\d [ \d]\d [ \d]\d [ \d]\d ")
HEAD_3 = re.compile(r"[GERCJ][ \d]\d \d{4} ")
# Galileo's data source: bits 0 and 2 I/NAV, bit 1 F/NAV; clock of bit 8 E5a, E1, of bit 9 E5b, E1.
INAV, FNAV, CLOCK_E5A, CLOCK_E5B = 0b101, 0b010, 1 << 8, 1 << 9
UNKNOWN_SISA = 255
# Upper limits of the user range accuracy, index 0 to 14 [2]_.
URA_M = (2.4, 3.4, 4.85, 6.85, 9.65, 13.65, 24, 48, 96, 192, 384, 768, 1536, 3072, 6144)

Coefficients = tuple[float, float, float, float]


class NavigationRecord(NamedTuple):
    """Satellite, the clock's reference time (GPS week and seconds), its polynomial (3,), and the
    numbers of the other lines, NaN where they are none."""

    satellite: str
    toc: tuple[int, float]
    clock: tuple[float, ...]
    numbers: list[float]

    @property
    def is_fnav(self) -> bool:
        """Whether the clock is that of Galileo's F/NAV, for E1 with E5a. Files without the clock's
        bits are judged by the signals; those with both signals have I/NAV's clock."""
        source = self.numbers[SOURCE] if self.satellite[0] == "E" else 0.0
        bits = int(source) if math.isfinite(source) else 0
        if bits & (CLOCK_E5A | CLOCK_E5B):
            return not bits & CLOCK_E5B
        return bool(bits & FNAV) and not bits & INAV


def read_navigation_file(
    path: Path,
) -> tuple[list[NavigationRecord], tuple[Coefficients, Coefficients] | None]:
    """The records of a navigation file, compressed or not, in its order, and its Klobuchar
    coefficients (alpha, beta), if there are any.

    Raises
    ------
    ConfigError
        If the file is not a RINEX navigation file, or has damaged Klobuchar coefficients.
    """
    lines = read_rinex_text(path)
    check_header(path, lines, KINDS, "a navigation file")
    found: dict[str, Coefficients] = {}
    try:
        for name, words in _klobuchar_words(lines):
            a, b, c, d = (_float(word) for word in words)
            found[name] = a, b, c, d
    except ValueError as error:
        raise ConfigError(f"{path}: an ionosphere field is not a number ({error})") from error
    return list(_records(lines)), (found["A"], found["B"]) if len(found) == 2 else None


def _klobuchar_words(lines: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield A or B (alpha, beta) and its four fields."""
    for i, line in enumerate(lines):
        label = line[60:].strip()
        if label == "IONOSPHERIC CORR" and line[:4] in ("GPSA", "GPSB"):
            yield line[3], [line[5 + 12 * k : 17 + 12 * k] for k in range(4)]
        elif label in ("ION ALPHA", "ION BETA"):
            yield label[4], [line[2 + 12 * k : 14 + 12 * k] for k in range(4)]
        elif line.startswith("> ION G") and line[10:].split() == ["LNAV"] and i + 3 < len(lines):
            # A record of RINEX 4 has three coefficients, four, and one, after the time.
            rows = ((lines[i + 1], 1, 4), (lines[i + 2], 0, 4), (lines[i + 3], 0, 1))
            words = [text[4 + 19 * k : 23 + 19 * k] for text, a, b in rows for k in range(a, b)]
            yield "A", words[:4]
            yield "B", words[4:]


def _float(text: str) -> float:
    """A Fortran number: with D in the exponent, or no letter before one of three digits."""
    text = text.strip().replace("D", "E").replace("d", "e")
    try:
        return float(text) if text else 0.0
    except ValueError:
        return float(re.sub(r"(?<=\d)([+-])", r"E\1", text))


def _float_or_nan(text: str) -> float:
    try:
        return _float(text)
    except ValueError:
        return math.nan


def _records(lines: Sequence[str]) -> Iterator[NavigationRecord]:
    version, system, readable = 3.0, "", True
    for at, line in enumerate(lines):
        if line[60:].startswith("RINEX VERSION"):  # of the file, or of another one appended to it
            version, kind, readable = _float_or_nan(line[:9]), line[20:21], True
            system = SYSTEM_2.get(kind, kind)
        elif line.startswith(">"):
            readable = line.startswith("> EPH") and line[10:].strip() in MESSAGES
        elif readable and (HEAD_2 if version < 3.0 else HEAD_3).match(line):
            record = _record(lines, at, system if version < 3.0 else "")
            if record is not None:
                yield record


def _record(lines: Sequence[str], at: int, system_2: str) -> NavigationRecord | None:
    """The record that starts at a line; None if it is damaged."""
    head, indent = lines[at], 3 if system_2 else 4
    name = (system_2 + head[:2] if system_2 else head[:3]).replace(" ", "0")
    count = BODY_LINES.get(name[0], 7)
    body: list[str] = []
    for line in lines[at + 1 : at + 1 + count]:
        if line[:indent].strip():
            break
        body.append(line)
    if len(body) < min(count, 6):
        return None
    rows = [head, *body]
    v = [_float_or_nan(r[indent + 19 * k : indent + 19 * k + 19]) for r in rows for k in range(4)]
    clock, numbers = tuple(v[1:4]), v[4:] + [0.0] * 4 * (count - len(body))
    try:
        words = head[3 if system_2 else 4 : indent + 19].split()
        toc = time_of_words(words, CLOCKS.get(name[0], "GPS"))
    except ValueError:
        return None
    unused = UNUSED.get(name[0], set())
    used = [x for i, x in enumerate(numbers[:24]) if i not in unused]
    if not all(math.isfinite(x) for x in (*clock, *used)):
        return None
    return NavigationRecord(name, toc, clock, numbers)


def kepler_ephemeris(record: NavigationRecord) -> Ephemeris:
    """The ephemeris of a record of GPS, Galileo, BeiDou or QZSS."""
    v, system = dict(zip(NUMBERS, record.numbers, strict=False)), record.satellite[0]
    galileo, lnav = system == "E", system in "GJ"
    toe_s = v["toe_s"] + (BEIDOU_OFFSET_S if system == "C" else 0.0)
    week, v["toc_s"] = record.toc
    week, v["toe_s"] = normalized(week + round((v["toc_s"] - toe_s) / WEEK_S), toe_s)
    v["af0_s"], v["af1"], v["af2_per_s"] = record.clock
    v["group_delay_s"] = v["delay_b"] if galileo and not record.is_fnav else v["delay"]
    v["group_delay_e5a_s"] = v["delay"] if galileo else 0.0
    indices = {"G": ura_index, "J": ura_index, "E": sisa_index}
    v["accuracy"] = indices[system](v["accuracy"]) if system in indices else 0
    v["long_fit"] = system == "G" and v["fit"] > 4.0
    if lnav:
        v["iodc"] = v["delay_b"]
    if galileo:
        v["health"] = _galileo_health(int(v["health"]))
    if system != "G":
        v["code"] = v["l2p"] = 0.0
    return ephemeris_of(record.satellite, week, v)


def ura_index(accuracy_m: float) -> int:
    """The GPS index of a user range accuracy in metres; 15 if none is predicted."""
    return next((i for i, limit in enumerate(URA_M) if accuracy_m <= limit), 15)


def sisa_index(accuracy_m: float) -> int:
    """The Galileo index of a signal-in-space accuracy [2]_; 255 if none."""
    for start, first, step in ((0.0, 0, 0.01), (0.5, 50, 0.02), (1.0, 75, 0.04), (2.0, 100, 0.16)):
        index = first + round((accuracy_m - start) / step)
        if accuracy_m >= start and index < {0: 50, 50: 75, 75: 100, 100: 126}[first]:
            return index
    return UNKNOWN_SISA


def _galileo_health(bits: int) -> int:
    """The health word of RINEX (bits 6 to 8: E5b, 3 to 5: E5a, 0 to 2: E1B) as in RTCM 1046; E5a
    counts as E5b does, for records that have no other."""

    def status_and_validity(word: int) -> int:
        return (word >> 1 & 3) << 1 | word & 1

    return status_and_validity(bits >> 6 | bits >> 3) << 3 | status_and_validity(bits)
