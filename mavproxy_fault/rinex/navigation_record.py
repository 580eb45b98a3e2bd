"""The numbers of a navigation record, after its first line.

References
----------
.. [1] IGS/RTCM, RINEX 3.05, tables A6 (GPS), A8 (Galileo), A14 (BeiDou).
"""

from collections.abc import Sequence
from typing import TypedDict

# Four per line. DELAY is T_GD, BGD(E1,E5a) or BeiDou's T_GD1; DELAY_B is Galileo's BGD(E1,E5b), for
# GPS the IODC; SOURCE is Galileo's data source, for GPS the codes on L2.
(IODE, CRS, DELTA_N, M0, CUC, ECCENTRICITY, CUS, SQRT_A) = range(8)
(TOE, CIC, OMEGA0, CIS, I0, CRC, OMEGA, OMEGA_DOT) = range(8, 16)
(IDOT, SOURCE, WEEK, L2P, ACCURACY, HEALTH, DELAY, DELAY_B) = range(16, 24)
SENT, FIT = 24, 25  # transmission time, and GPS's fit interval [h]


class OrbitElements(TypedDict):
    """Orbital elements with the names of `Ephemeris`; the last six are the second harmonics of
    radius, argument of latitude and inclination."""

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


def orbit_elements(v: Sequence[float]) -> OrbitElements:
    """Return the orbital elements of a record's numbers."""
    return OrbitElements(
        sqrt_a=v[SQRT_A],
        eccentricity=v[ECCENTRICITY],
        i0_rad=v[I0],
        omega0_rad=v[OMEGA0],
        omega_rad=v[OMEGA],
        m0_rad=v[M0],
        delta_n_rps=v[DELTA_N],
        omega_dot_rps=v[OMEGA_DOT],
        idot_rps=v[IDOT],
        crs_m=v[CRS],
        crc_m=v[CRC],
        cus_rad=v[CUS],
        cuc_rad=v[CUC],
        cis_rad=v[CIS],
        cic_rad=v[CIC],
    )
