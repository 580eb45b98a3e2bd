"""Broadcast ephemerides as RTCM 1019 (GPS LNAV) and 1046 (Galileo I/NAV).

The message layouts are tables of (field, bits, scale); `Ephemeris` has the same numbers in SI units
and radians. Semicircles are converted with the standards' own value of pi [1]_ [2]_ [3]_.

References
----------
.. [1] RTCM 10403.3, tables 3.5-21 (1019) and 3.5-107 (1046).
.. [2] IS-GPS-200N, section 20.3.3.
.. [3] Galileo OS SIS ICD 2.1, sections 4.3 and 5.1.
.. [4] IS-QZSS-PNT, ephemeris of LNAV: the six health bits by signal. The document was not
   available; claslib (`satsigexclude`) and messages of 2024, all with 1, agree with this reading.
"""

from dataclasses import dataclass
from typing import Any

from mavproxy_fault.rtcm.bit_fields import BitReader, pack_columns
from mavproxy_fault.rtcm.transport import unwrap_message, wrap_message

NUMBERS = {"G": 1019, "E": 1046}
SYSTEMS = {number: system for system, number in NUMBERS.items()}

SEMICIRCLE = 3.1415926535898  # rad; IS-GPS-200N 20.3.3.4.3.3 and Galileo OS SIS ICD table 66
ROLLOVER_WEEK = 2048  # start of the ten-bit GPS week until November 2038
GALILEO_WEEK_OFFSET = 1024  # GPS week of Galileo week 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Ephemeris:
    """The broadcast orbit and clock of a GPS, Galileo or QZSS satellite; names of the standards.

    Angles in rad, rates in rad/s, correction amplitudes `crs`, `crc` in m and `cuc` ... `cis` in
    rad, `sqrt_a` in m^0.5. `week` is the full GPS week of `toe_s` and `toc_s` (seconds of week).
    `group_delay_s` is what a single-frequency user of L1 or E1 subtracts from the clock: T_GD, or
    BGD(E1,E5b); `group_delay_e5a_s` is BGD(E1,E5a). `accuracy` is the URA or SISA index, `health`
    is 0 for a healthy satellite (GPS six bits; QZSS `l1_health` of them; Galileo E5b health and
    data validity, then E1's). `codes` are GPS's code on L2 and L2 P flag; `long_fit` is its fit
    interval flag.
    """

    satellite: str
    week: int
    toe_s: float
    toc_s: float
    af0_s: float
    af1: float
    af2_per_s: float
    iode: int
    iodc: int
    sqrt_a: float
    eccentricity: float
    i0_rad: float
    omega0_rad: float
    omega_rad: float
    m0_rad: float
    delta_n_rps: float
    omega_dot_rps: float
    idot_rps: float
    crs_m: float
    crc_m: float
    cus_rad: float
    cuc_rad: float
    cis_rad: float
    cic_rad: float
    group_delay_s: float
    group_delay_e5a_s: float = 0.0
    accuracy: int = 0
    health: int = 0
    codes: tuple[int, int] = (0, 0)
    long_fit: bool = False

    @property
    def fit_half_s(self) -> float:
        """Validity before and after `toe_s`: 2 h (GPS, 3 h with the long fit; QZSS), 4 h (Galileo).

        IS-GPS-200N 20.3.4.4; Galileo OS SDD 1.3, 2.4.2: navigation data is used for up to 4 h.
        """
        if self.satellite[0] == "E":
            return 14_400.0
        return 10_800.0 if self.long_fit and self.satellite[0] == "G" else 7_200.0


Row = tuple[str, int, float]  # attribute, bits (negative: signed), scale

# Galileo has these two groups of fields with the same bits and scales as GPS.
SHAPE_ROWS: tuple[Row, ...] = (
    ("crs_m", -16, 2**-5),
    ("delta_n_rps", -16, SEMICIRCLE * 2**-43),
    ("m0_rad", -32, SEMICIRCLE * 2**-31),
    ("cuc_rad", -16, 2**-29),
    ("eccentricity", 32, 2**-33),
    ("cus_rad", -16, 2**-29),
    ("sqrt_a", 32, 2**-19),
)
ORIENTATION_ROWS: tuple[Row, ...] = (
    ("cic_rad", -16, 2**-29),
    ("omega0_rad", -32, SEMICIRCLE * 2**-31),
    ("cis_rad", -16, 2**-29),
    ("i0_rad", -32, SEMICIRCLE * 2**-31),
    ("crc_m", -16, 2**-5),
    ("omega_rad", -32, SEMICIRCLE * 2**-31),
    ("omega_dot_rps", -24, SEMICIRCLE * 2**-43),
)

GPS_ROWS: tuple[Row, ...] = (
    ("number", 12, 1),
    ("prn", 6, 1),
    ("week", 10, 1),
    ("accuracy", 4, 1),
    ("code", 2, 1),
    ("idot_rps", -14, SEMICIRCLE * 2**-43),
    ("iode", 8, 1),
    ("toc_s", 16, 16),
    ("af2_per_s", -8, 2**-55),
    ("af1", -16, 2**-43),
    ("af0_s", -22, 2**-31),
    ("iodc", 10, 1),
    *SHAPE_ROWS,
    ("toe_s", 16, 16),
    *ORIENTATION_ROWS,
    ("group_delay_s", -8, 2**-31),
    ("health", 6, 1),
    ("l2p", 1, 1),
    ("long_fit", 1, 1),
)

GALILEO_ROWS: tuple[Row, ...] = (
    ("number", 12, 1),
    ("prn", 6, 1),
    ("week", 12, 1),
    ("iode", 10, 1),
    ("accuracy", 8, 1),
    ("idot_rps", -14, SEMICIRCLE * 2**-43),
    ("toc_s", 14, 60),
    ("af2_per_s", -6, 2**-59),
    ("af1", -21, 2**-46),
    ("af0_s", -31, 2**-34),
    *SHAPE_ROWS,
    ("toe_s", 14, 60),
    *ORIENTATION_ROWS,
    ("group_delay_e5a_s", -10, 2**-32),
    ("group_delay_s", -10, 2**-32),
    ("health", 6, 1),
    ("reserved", 2, 1),
)

QZSS_L1, QZSS_CA, QZSS_CB = 0b100000, 0b010000, 0b000001  # health bits of these signals
_ROWS = {"G": GPS_ROWS, "E": GALILEO_ROWS}
_WRAPPED = {"m0_rad", "omega0_rad", "omega_rad"}  # wrap at half a revolution


def encode_ephemeris(ephemeris: Ephemeris) -> bytes:
    """Encode the complete RTCM message, 1019 or 1046 by the satellite's system.

    Raises
    ------
    KeyError
        If the satellite is neither GPS nor Galileo.
    ValueError
        If a value does not fit its field.
    """
    system = ephemeris.satellite[0]
    # GPS sends ten bits of its week, Galileo twelve bits of its own week count.
    week = ephemeris.week % 1024 if system == "G" else ephemeris.week - GALILEO_WEEK_OFFSET
    extra = {
        "number": NUMBERS[system],
        "prn": int(ephemeris.satellite[1:]),
        "week": week,
        "code": ephemeris.codes[0],
        "l2p": ephemeris.codes[1],
        "reserved": 0,
    }
    fields = []
    for name, bits, step in _ROWS[system]:
        value = extra[name] if name in extra else getattr(ephemeris, name)
        count = round(value / step)
        if name in _WRAPPED:
            # Half a revolution would round to one count more than the field can hold.
            count = (count + 2**31) % 2**32 - 2**31
        fields.append(((count,), abs(bits)))
    return wrap_message(pack_columns(fields))


def decode_ephemeris(message: bytes, rollover_week: int = ROLLOVER_WEEK) -> Ephemeris:
    """Decode a complete 1019 or 1046 message; GPS weeks count from `rollover_week`.

    Raises
    ------
    ValueError
        If it is not such a message with a valid CRC.
    """
    body = unwrap_message(message)
    number = BitReader(body).unsigned(12)
    if number not in SYSTEMS:
        raise ValueError(f"RTCM {number} is not an ephemeris of GPS or Galileo (1019, 1046)")
    system = SYSTEMS[number]
    # From the start again, since the tables include the message number.
    values = read_fields(BitReader(body), _ROWS[system])
    offset = GALILEO_WEEK_OFFSET if system == "E" else rollover_week
    name = f"{system}{int(values['prn']):02d}"
    return ephemeris_of(name, int(values["week"]) + offset, values)


def read_fields(bits: BitReader, rows: tuple[Row, ...]) -> dict[str, float]:
    """Read the fields of a table in their units."""
    values: dict[str, float] = {}
    for name, width, step in rows:
        values[name] = bits.column(1, width)[0] * step
    return values


def l1_health(satellite: str, bits: int) -> int:
    """Return a satellite's L1 health, without QZSS's health bits of other signals [4]_.

    A QZSS satellite sends either C/A or C/B on L1 and marks the other one unhealthy; L1 is
    unhealthy only if both are.
    """
    if satellite[0] != "J":
        return bits
    codes = bits & (QZSS_CA | QZSS_CB)
    return bits & QZSS_L1 | (codes if codes == QZSS_CA | QZSS_CB else 0)


def ephemeris_of(satellite: str, week: int, values: dict[str, float]) -> Ephemeris:
    """Build the ephemeris from the fields of a message; other fields are ignored."""
    counts = {name: int(values[name]) for name in ("iode", "accuracy")}
    reals = {
        name: float(value)
        for name, value in values.items()
        if name.endswith(("_s", "_m", "_rad", "_rps")) or name in ("af1", "sqrt_a", "eccentricity")
    }
    rest: dict[str, Any] = {**counts, **reals}
    return Ephemeris(
        satellite=satellite,
        week=week,
        iodc=int(values.get("iodc", values["iode"])),
        health=l1_health(satellite, int(values["health"])),
        codes=(int(values.get("code", 0)), int(values.get("l2p", 0))),
        long_fit=bool(values.get("long_fit", 0)),
        **rest,
    )
