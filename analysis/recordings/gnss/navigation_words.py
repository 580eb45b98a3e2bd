"""Decode ephemerides from raw navigation messages: GPS and QZSS subframes, Galileo I/NAV words.

Fields, widths and scales are those of RTCM 1019 and 1046; the tables here give their positions [1]_
[2]_. Satellites transmit ten or twelve bits of the week, so the week of an ephemeris is the one
that puts its reference time nearest to the recording.

References
----------
.. [1] IS-GPS-200N, figures 20-1 (subframes 1 to 3, and page 18 of 4), tables 20-I to 20-III, 20-X.
.. [2] Galileo OS SIS ICD 2.1, sections 4.3.2 (pages), 4.3.5 (words 1 to 5), 5.1.9.4 (CRC).
"""

from collections.abc import Sequence

from mavproxy_fault.rtcm.bit_fields import BitReader
from mavproxy_fault.rtcm.ephemeris_messages import (
    GALILEO_ROWS,
    GPS_ROWS,
    ORIENTATION_ROWS,
    SHAPE_ROWS,
    Ephemeris,
    Row,
    ephemeris_of,
    read_fields,
)
from mavproxy_fault.rtcm.transport import crc24q

Coefficients = tuple[float, float, float, float]  # of Klobuchar's model

WEEK_S = 604_800
PREAMBLE = 0x8B
KLOBUCHAR_PAGE = 56  # the page's id in subframe 4
KLOBUCHAR_STEPS = (2**-30, 2**-27, 2**-24, 2**-24, 2**11, 2**14, 2**16, 2**16)


def _rows(table: tuple[Row, ...], names: str) -> tuple[Row, ...]:
    """The rows of a table by name; a number skips that many bits."""
    known = {row[0]: row for row in table}
    return tuple(("", int(n), 1) if n.isdigit() else known[n] for n in names.split())


_SUBFRAMES: dict[int, tuple[Row, ...]] = {
    1: (
        *_rows(GPS_ROWS, "week code accuracy health"),
        ("iodc_high", 2, 1),
        *_rows(GPS_ROWS, "l2p 87 group_delay_s"),
        ("iodc_low", 8, 1),
        *_rows(GPS_ROWS, "toc_s af2_per_s af1 af0_s"),
    ),
    2: (*_rows(GPS_ROWS, "iode"), *SHAPE_ROWS, *_rows(GPS_ROWS, "toe_s long_fit")),
    3: (*ORIENTATION_ROWS, *_rows(GPS_ROWS, "iode idot_rps")),
}
_INAV: dict[int, tuple[Row, ...]] = {  # after the six bits of the word's type
    1: _rows(GALILEO_ROWS, "6 iode toe_s m0_rad eccentricity sqrt_a"),
    2: _rows(GALILEO_ROWS, "6 iode omega0_rad i0_rad omega_rad idot_rps"),
    3: _rows(GALILEO_ROWS, "6 iode omega_dot_rps delta_n_rps cuc_rad cus_rad crc_m crs_m accuracy"),
    4: _rows(GALILEO_ROWS, "6 iode prn cic_rad cis_rad toc_s af0_s af1 af2_per_s"),
    5: (
        *_rows(GALILEO_ROWS, "47 group_delay_e5a_s group_delay_s"),
        ("e5b_health", 2, 1),
        ("e1_health", 2, 1),
        ("e5b_invalid", 1, 1),
        ("e1_invalid", 1, 1),
    ),
}


def parse_subframe(words: Sequence[int]) -> tuple[int, bytes] | None:
    """Number (1 to 5) and data of a subframe of ten 30-bit words, without their parity; None
    without the preamble."""
    if len(words) < 10:
        return None
    data = b"".join((word >> 6 & 0xFFFFFF).to_bytes(3, "big") for word in words[:10])
    return (data[5] >> 2 & 7, data) if data[0] == PREAMBLE else None


def klobuchar_coefficients(number: int, data: bytes) -> tuple[Coefficients, Coefficients] | None:
    """Klobuchar alpha and beta; None if the subframe is not page 18 of subframe 4."""
    if number != 4 or data[6] & 0x3F != KLOBUCHAR_PAGE:
        return None
    counts = BitReader(data[7:15]).column(8, -8)
    a0, a1, a2, a3, b0, b1, b2, b3 = (
        count * step for count, step in zip(counts, KLOBUCHAR_STEPS, strict=True)
    )
    return (a0, a1, a2, a3), (b0, b1, b2, b3)


def gps_ephemeris(satellite: str, subframes: dict[int, bytes], near_s: float) -> Ephemeris | None:
    """The ephemeris of the newest subframes 1, 2 and 3; None while their issues of data differ.

    `near_s` is the approximate time of transmission, in s since the start of GPS time.
    """
    if not all(number in subframes for number in _SUBFRAMES):
        return None
    parts = {k: read_fields(BitReader(subframes[k][6:]), rows) for k, rows in _SUBFRAMES.items()}
    if not parts[1]["iodc_low"] == parts[2]["iode"] == parts[3]["iode"]:
        return None
    values = parts[1] | parts[2] | parts[3]
    values["iodc"] = 256 * values["iodc_high"] + values["iodc_low"]
    return ephemeris_of(satellite, week_near(values["toe_s"], near_s), values)


def parse_inav_word(words: Sequence[int]) -> tuple[int, bytes] | None:
    """Type and 128 bits of a page's I/NAV word, given as even and odd part of four 32-bit words.

    None for an alert page or a wrong CRC.
    """
    if len(words) < 8:
        return None
    even, odd = (
        int.from_bytes(b"".join(word.to_bytes(4, "big") for word in words[k : k + 4]), "big")
        for k in (0, 4)
    )
    # The two leading bits of each part: even or odd, nominal or alert.
    if even >> 126 != 0b00 or odd >> 126 != 0b10:
        return None
    # The 24-bit CRC covers 114 bits of the even part and 82 of the odd part.
    summed = even >> 14 << 82 | odd >> 46
    if crc24q(summed.to_bytes(25, "big")) != odd >> 22 & 0xFFFFFF:
        return None
    word = ((even >> 14 & (1 << 112) - 1) << 16 | odd >> 110 & 0xFFFF).to_bytes(16, "big")
    return word[0] >> 2, word


def inav_ephemeris(satellite: str, words: dict[int, bytes], near_s: float) -> Ephemeris | None:
    """The ephemeris of the newest I/NAV words 1 to 5; None while their issues of data differ."""
    if not all(kind in words for kind in _INAV):
        return None
    parts = {kind: read_fields(BitReader(words[kind]), rows) for kind, rows in _INAV.items()}
    # Word 5 has no issue of data.
    if len({parts[kind]["iode"] for kind in (1, 2, 3, 4)}) > 1:
        return None
    if int(parts[4]["prn"]) != int(satellite[1:]):
        return None
    values = {name: value for part in parts.values() for name, value in part.items()}
    e5b = 2 * values["e5b_health"] + values["e5b_invalid"]
    values["health"] = 8 * e5b + 2 * values["e1_health"] + values["e1_invalid"]
    return ephemeris_of(satellite, week_near(values["toe_s"], near_s), values)


def week_near(toe_s: float, near_s: float) -> int:
    """The GPS week in which the time of week `toe_s` is nearest to `near_s` (s of GPS time)."""
    return round((near_s - toe_s) / WEEK_S)
