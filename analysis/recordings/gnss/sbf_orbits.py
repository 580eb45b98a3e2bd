"""Read ephemerides and Klobuchar coefficients from the navigation blocks of Septentrio SBF.

SBF gives angles in semicircles and values as broadcast, without further rounding [1]_. BeiDou times
are in BeiDou time, GLONASS times in GPS time. Of Galileo only I/NAV is read, which every satellite
sends on E1.

References
----------
.. [1] Septentrio, mosaic-X5 and PolaRx5 reference guides, 4.2: GPSNav, GPSIon, GALNav, QZSNav,
   BDSNav, GLONav; 4.1.9 (numbers of satellites). Fields as pysbf2 1.0 has them, which is the judge
   in the tests.
"""

from collections.abc import Sequence

import numpy as np

from analysis.orbits.broadcast import BEIDOU_TIME_OFFSET_S
from analysis.recordings.gnss.navigation_words import WEEK_S, week_near
from analysis.samples.sample import EphemerisSample, IonosphereSample, StateVector
from mavproxy_fault.rtcm.ephemeris_messages import SEMICIRCLE, ephemeris_of

GPS_NAV, GPS_ION, GLO_NAV, GAL_NAV, BDS_NAV, QZS_NAV = 5891, 5893, 4004, 4002, 4081, 4095
STAMP = [("tow_ms", "<u4"), ("week", "<u2")]
# Clock and orbit fields common to GPS, QZSS and BeiDou.
ELEMENTS = (
    [("toc_s", "<u4")]
    + [(name, "<f4") for name in ("af2_per_s", "af1", "af0_s", "crs_m", "delta_n_rps")]
    + [("m0_rad", "<f8"), ("cuc_rad", "<f4"), ("eccentricity", "<f8"), ("cus_rad", "<f4")]
    + [("sqrt_a", "<f8"), ("toe_s", "<u4"), ("cic_rad", "<f4"), ("omega0_rad", "<f8")]
    + [("cis_rad", "<f4"), ("i0_rad", "<f8"), ("crc_m", "<f4"), ("omega_rad", "<f8")]
    + [("omega_dot_rps", "<f4"), ("idot_rps", "<f4")]
)
GPS_FIELDS = np.dtype([
    *STAMP, ("satellite", "u1"), ("", "V3"), ("code", "u1"), ("accuracy", "u1"), ("health", "u1"),
    ("l2p", "u1"), ("iodc", "<u2"), ("iode", "u1"), ("", "V1"), ("long_fit", "u1"), ("", "V1"),
    ("group_delay_s", "<f4"), *ELEMENTS,
])  # fmt: skip
BEIDOU_FIELDS = np.dtype([
    *STAMP, ("satellite", "u1"), ("", "V3"), ("accuracy", "u1"), ("health", "u1"), ("iodc", "u1"),
    ("iode", "u1"), ("", "V2"), ("group_delay_s", "<f4"), ("", "V4"), *ELEMENTS,
])  # fmt: skip
GLONASS_FIELDS = np.dtype(
    [*STAMP, ("satellite", "u1"), ("", "V1"), *((axis, "<f8") for axis in "xyz")]
    + [(k + axis, "<f4") for k in ("d", "dd") for axis in "xyz"]
    + [("gamma", "<f4"), ("tau_s", "<f4"), ("", "V4"), ("toe_s", "<u4"), ("", "V5")]
    + [("health", "u1"), ("", "V4"), ("unhealthy", "u1")]
)
GALILEO_FIELDS = np.dtype(
    [*STAMP, ("satellite", "u1"), ("source", "u1"), ("sqrt_a", "<f8"), ("m0_rad", "<f8")]
    + [(name, "<f8") for name in ("eccentricity", "i0_rad", "omega_rad", "omega0_rad")]
    + [(name, "<f4") for name in ("omega_dot_rps", "idot_rps", "delta_n_rps", "cuc_rad")]
    + [(name, "<f4") for name in ("cus_rad", "crc_m", "crs_m", "cic_rad", "cis_rad")]
    + [("toe_s", "<u4"), ("toc_s", "<u4"), ("af2_per_s", "<f4"), ("af1", "<f4")]
    + [("af0_s", "<f8"), ("", "V4"), ("iode", "<u2"), ("health", "<u2"), ("", "V2")]
    + [("accuracy", "u1"), ("", "V1"), ("group_delay_e5a_s", "<f4"), ("group_delay_s", "<f4")]
)
ION_FIELDS = np.dtype([*STAMP, ("", "V2"), ("alpha", "<f4", 4), ("beta", "<f4", 4)])
ORBITS = {
    GPS_NAV: GPS_FIELDS,
    QZS_NAV: GPS_FIELDS,
    GAL_NAV: GALILEO_FIELDS,
    GLO_NAV: GLONASS_FIELDS,
    BDS_NAV: BEIDOU_FIELDS,
    GPS_ION: ION_FIELDS,
}
NOT_KNOWN = -2e10  # SBF's "do not use" value of a real number
INAV = 2
E1_HEALTH_VALID = 1
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


def read_orbit(
    block: int, payload: bytes, near_s: float
) -> EphemerisSample | IonosphereSample | None:
    """Decode one block of `ORBITS`, with timestamp 0; None if its content is not usable.

    `near_s` is the approximate time of reception, in s since the start of GPS time.
    """
    fields = ORBITS[block]
    if len(payload) < fields.itemsize:
        return None
    row = np.frombuffer(payload, fields, 1)[0]
    if block == GPS_ION:
        a, b = row["alpha"].tolist(), row["beta"].tolist()
        if NOT_KNOWN in a + b:
            return None
        return IonosphereSample(0, (a[0], a[1], a[2], a[3]), (b[0], b[1], b[2], b[3]))
    values = {name: row[name].item() for name in fields.names or () if row[name].dtype.kind in "uf"}
    name = satellite_name(int(values["satellite"]))
    if block == GAL_NAV and not _as_inav(values):
        return None
    # A time of week out of range also means "do not use".
    if name is None or not values["toe_s"] < WEEK_S or NOT_KNOWN in values.values():
        return None
    if block == BDS_NAV:
        for key in ("toe_s", "toc_s"):
            values[key] = (values[key] + BEIDOU_TIME_OFFSET_S) % WEEK_S
    week = week_near(values["toe_s"], near_s)
    if block == GLO_NAV:
        return EphemerisSample(0, _state_vector(name, week, values))
    values |= {name: values[name] * SEMICIRCLE for name in SEMICIRCLES}
    return EphemerisSample(0, ephemeris_of(name, week, values))


def _as_inav(values: dict[str, float]) -> bool:
    """Whether it is I/NAV with E1's health; converts the health bits to the order of `Ephemeris`.

    `Ephemeris` has E5b's two bits and validity first, then E1's. SBF has E1's first, each preceded
    by a bit that says whether they are valid.
    """
    bits = int(values["health"])
    e1, e5b = bits >> 1 & 7, bits >> 5 & 7  # each one's validity, below its two bits
    values["health"] = 8 * (2 * (e5b >> 1) + (e5b & 1)) + 2 * (e1 >> 1) + (e1 & 1)
    # The E1-E5b group delay is used; E1-E5a may be missing.
    if values["group_delay_e5a_s"] == NOT_KNOWN:
        values["group_delay_e5a_s"] = 0.0
    return values["source"] == INAV and bool(bits & E1_HEALTH_VALID)


def _state_vector(name: str, week: int, values: dict[str, float]) -> StateVector:
    """A GLONASS state vector; lengths are in km, the clock has the sign of the correction."""
    r, v, a = (
        (1000.0 * values[f"{k}x"], 1000.0 * values[f"{k}y"], 1000.0 * values[f"{k}z"])
        for k in ("", "d", "dd")
    )
    health = int(values["health"]) | int(values["unhealthy"])
    toe_s, tau_s, gamma = values["toe_s"], values["tau_s"], values["gamma"]
    return StateVector(name, week, toe_s, r, v, a, -tau_s, gamma, health)
