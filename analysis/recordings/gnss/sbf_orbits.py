"""Read ephemerides and Klobuchar coefficients from the navigation blocks of Septentrio SBF.

SBF gives angles in semicircles and values as broadcast, without further rounding [1]_. BeiDou times
are in BeiDou time, GLONASS times in GPS time. Of Galileo only I/NAV is read, which every satellite
sends on E1.

References
----------
.. [1] Septentrio, mosaic-X5 and PolaRx5 reference guides, 4.2: GPSNav, GPSIon, GALNav, QZSNav,
   BDSNav, GLONav; 4.1.9 (numbers of satellites). pysbf2 knows their fields.
"""

from collections.abc import Mapping, Sequence

from analysis.recordings.gnss.navigation_words import WEEK_S, week_near
from analysis.samples.sample import EphemerisSample, IonosphereSample, StateVector
from mavproxy_fault.documents.extras import import_extra
from mavproxy_fault.rinex.gps_clock import BEIDOU_OFFSET_S
from mavproxy_fault.rtcm.ephemeris_messages import SEMICIRCLE, ephemeris_of

GPS_NAV, GPS_ION, GLO_NAV, GAL_NAV, BDS_NAV, QZS_NAV = 5891, 5893, 4004, 4002, 4081, 4095
ORBITS = (GPS_NAV, GPS_ION, GLO_NAV, GAL_NAV, BDS_NAV, QZS_NAV)
# pysbf2's names of the fields; a block has those of its system.
FIELDS = {
    "toe_s": "t_oe", "toc_s": "t_oc", "af2_per_s": "a_f2", "af1": "a_f1", "af0_s": "a_f0",
    "crs_m": "C_rs", "crc_m": "C_rc", "cus_rad": "C_us", "cuc_rad": "C_uc", "cis_rad": "C_is",
    "cic_rad": "C_ic", "sqrt_a": "SQRT_A", "eccentricity": "e", "m0_rad": "M_0", "i0_rad": "i_0",
    "omega0_rad": "OMEGA_0", "omega_rad": "omega", "delta_n_rps": "DEL_N", "idot_rps": "IDOT",
    "omega_dot_rps": "OMEGADOT", "iodc": "IODC", "code": "CAorPonL2", "l2p": "L2DataFlag",
    "long_fit": "FitIntFlg",
}  # fmt: skip
OWN_FIELDS = {
    GPS_NAV: {"iode": "IODE2", "accuracy": "URA", "health": "health", "group_delay_s": "T_gd"},
    GAL_NAV: {"iode": "IODnav", "accuracy": "SISA_L1E5b", "group_delay_s": "BGD_L1E5b"},
    BDS_NAV: {"iode": "IODE", "accuracy": "URA", "health": "SatH1", "group_delay_s": "T_GD1"},
}
OWN_FIELDS[GLO_NAV] = {kind + axis: kind + axis for kind in ("", "D", "Dd") for axis in "xyz"}
OWN_FIELDS[GLO_NAV] |= {"x": "X", "y": "Y", "z": "Z"}
OWN_FIELDS[GLO_NAV] |= {"gamma": "gamma", "tau_s": "tau", "health": "B", "unhealthy": "l"}
OWN_FIELDS[QZS_NAV] = OWN_FIELDS[GPS_NAV]
NOT_KNOWN = -2e10  # SBF's "do not use" value of a real number
INAV = 2
NUMBER = 0x1FFF  # bits of the block number, below its revision
SEMICIRCLES = frozenset(
    ["m0_rad", "omega0_rad", "omega_rad", "i0_rad", "delta_n_rps", "omega_dot_rps", "idot_rps"]
)
NUMBERS = (  # first and last SVID, system letter, offset to the satellite number
    (1, 37, "G", 0),
    (38, 61, "R", 37),
    (63, 68, "R", 38),
    (71, 106, "E", 70),
    (141, 180, "C", 140),
    (181, 190, "J", 180),
    (223, 245, "C", 182),
)


def satellite_name(
    number: int, numbers: Sequence[tuple[int, int, str, int]] = NUMBERS
) -> str | None:
    """The name of the satellite with an SVID; None for unsupported systems (SBAS, NavIC)."""
    for first, last, letter, added in numbers:
        if first <= number <= last:
            return f"{letter}{number - added:02d}"
    return None


def block_number(block: bytes) -> int:
    """The number of a complete block, below its revision."""
    return int.from_bytes(block[4:6], "little") & NUMBER


def read_orbit(block: bytes, near_s: float) -> EphemerisSample | IonosphereSample | None:
    """Decode one block of `ORBITS`, with timestamp 0; None if its content is not usable.

    `near_s` is the approximate time of reception, in s since the start of GPS time.
    """
    pysbf2 = import_extra("pysbf2")
    try:
        read = vars(pysbf2.SBFReader.parse(block, validate=pysbf2.VALNONE, scaling=False))
    except pysbf2.SBFTypeError:  # too short
        return None
    number = block_number(block)
    if number == GPS_ION:
        a, b = ([read[f"{name}_{i}"] for i in range(4)] for name in ("alpha", "beta"))
        if NOT_KNOWN in a + b:
            return None
        return IonosphereSample(0, (a[0], a[1], a[2], a[3]), (b[0], b[1], b[2], b[3]))
    fields = FIELDS | OWN_FIELDS[number]
    values = {ours: read[theirs] for ours, theirs in fields.items() if theirs in read}
    name = satellite_name(read["SVID"] if "SVID" in read else read["PRN"])
    # A time of week out of range also means "do not use".
    if name is None or not values["toe_s"] < WEEK_S or NOT_KNOWN in values.values():
        return None
    if number == GAL_NAV:
        if read["Source"] != INAV or not read["L1-BHealth"]:
            return None
        # In the order of `Ephemeris`: E5b's two bits and validity first, then E1's.
        e1, e5b = (2 * read[f"{signal}hs"] + read[f"{signal}dvs"] for signal in ("L1-B", "E5b"))
        values["health"] = 8 * e5b + e1
        # The E1-E5b group delay is used; E1-E5a may be missing.
        delay_s = read["BGD_L1E5a"]
        values["group_delay_e5a_s"] = delay_s if delay_s != NOT_KNOWN else 0.0
    elif number == BDS_NAV:
        for key in ("toe_s", "toc_s"):
            values[key] = (values[key] + BEIDOU_OFFSET_S) % WEEK_S
    week = week_near(values["toe_s"], near_s)
    if number == GLO_NAV:
        return EphemerisSample(0, _state_vector(name, week, values))
    values |= {name: values[name] * SEMICIRCLE for name in SEMICIRCLES}
    return EphemerisSample(0, ephemeris_of(name, week, values))


def _state_vector(name: str, week: int, values: Mapping[str, float]) -> StateVector:
    """A GLONASS state vector; lengths are in km, the clock has the sign of the correction."""
    r, v, a = (
        (1000.0 * values[f"{k}x"], 1000.0 * values[f"{k}y"], 1000.0 * values[f"{k}z"])
        for k in ("", "D", "Dd")
    )
    health = int(values["health"]) | int(values["unhealthy"])
    return StateVector(
        name, week, values["toe_s"], r, v, a, -values["tau_s"], values["gamma"], health
    )
