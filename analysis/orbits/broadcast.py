"""Orbits and clocks of five satellite systems from broadcast ephemerides, and atmospheric delays.

Positions and velocities follow the algorithm of the interface documents [1]_ [2]_ with the velocity
in closed form; the ionosphere is Klobuchar's model
[1]_, the troposphere Saastamoinen's zenith delay [3]_ in the standard atmosphere with the mapping
of Black and Eisner [4]_.

References
----------
.. [1] IS-GPS-200N, 20.3.3.3.3 (clock), 20.3.3.4.3 (orbit), 20.3.3.5.2.5 (ionosphere).
.. [2] Galileo OS SIS ICD 2.1, sections 5.1.1 and 5.1.4; BDS-SIS-ICD-B1I 3.0, sections 5.2.4.9 to
   5.2.4.12. GLONASS: `glonass`.
.. [3] J. Saastamoinen, Bulletin Geodesique 107, 1973.
.. [4] H. D. Black and A. Eisner, J. Geophys. Res. 89 (D2), 1984.
.. [5] IS-QZSS-PNT: L1 C/A with GPS's message (LNAV) and GPS's constants.
"""

import math

import numpy as np

from analysis.orbits.glonass import propagate_state
from analysis.samples.block import Indices
from analysis.samples.sample import Orbit, PreciseOrbit, StateVector, Vector
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import (
    BEIDOU_EARTH_RATE_RPS,
    GNSS_EARTH_RATE_RPS,
    GPS_GM_M3PS2,
    L1_HZ,
    SPEED_OF_LIGHT_MPS,
    WGS84_GM_M3PS2,
)
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.rinex.gps_clock import BEIDOU_OFFSET_S, WEEK_S
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

# First letters of satellite names: GPS, Galileo, GLONASS, BeiDou, QZSS.
SYSTEMS = "GERCJ"
# Index of the receiver clock of each system; all but the first have an inter-system bias. QZSS
# transmits GPS's signal on GPS time [5]_, so the two share a clock.
CLOCK_OF = {"G": 0, "E": 1, "R": 2, "C": 3, "J": 0}
CLOCKS = 4
GEOSTATIONARY = (*range(1, 6), *range(59, 64))  # of BeiDou, by satellite number
B1I_HZ = 1561.098e6
E5A_HZ = 1176.45e6
B3I_HZ = 1268.52e6  # BeiDou's clock reference: no group delay

# Klobuchar coefficients of a day with low to moderate solar activity, used if none are broadcast.
TYPICAL_ALPHA = (1.118e-8, 7.451e-9, -5.96e-8, -5.96e-8)
TYPICAL_BETA = (9.011e4, 0.0, -1.966e5, -6.554e4)

_ORBIT_FIELDS = ("sqrt_a", "eccentricity", "i0_rad", "omega0_rad", "omega_rad", "m0_rad")
_RATE_FIELDS = ("delta_n_rps", "omega_dot_rps", "idot_rps")
_WAVE_FIELDS = ("crs_m", "crc_m", "cus_rad", "cuc_rad", "cis_rad", "cic_rad")
_CLOCK_FIELDS = ("toe_s", "toc_s", "af0_s", "af1", "af2_per_s")
_FIELDS = (*_CLOCK_FIELDS, *_ORBIT_FIELDS, *_RATE_FIELDS, *_WAVE_FIELDS, "group_delay_s")
# Columns of `pack_ephemeris`; the middle ones are `_FIELDS`, in their order and units.
(MU, WEEK) = range(2)
(TOE, TOC, AF0, AF1, AF2) = range(2, 7)
(SQRT_A, ECCENTRICITY, I0, OMEGA0, OMEGA, M0, DELTA_N, OMEGA_DOT, IDOT) = range(7, 16)
(CRS, CRC, CUS, CUC, CIS, CIC, GROUP_DELAY, KIND, IONOSPHERE, NOISE, PACKED) = range(16, 27)
VECTOR = SQRT_A  # of a GLONASS state vector (9), or of a polynomial (15)
ELEMENTS, GEOSTATIONARY_ORBIT, STATE_VECTOR, POLYNOMIAL = 0.0, 1.0, 2.0, 3.0  # kinds of orbit
# Columns of `satellite_states`.
POSITION, VELOCITY, CLOCK, CLOCK_RATE, DELAY_SCALE, STATES = 0, 3, 6, 7, 8, 9
# Columns of `predict_ranges`: range, range rate, line of sight (3), elevation, azimuth and
# ionospheric delay.
RANGE, RATE, LINE_OF_SIGHT, ELEVATION, AZIMUTH, DELAY, PREDICTED = 0, 1, 2, 5, 6, 7, 8


def pack_ephemeris(ephemeris: Orbit) -> Vector:
    """Pack one ephemeris as an array (26,): mu, week, `_FIELDS` in order, the kind of orbit (0
    Kepler elements, 1 those of a geostationary satellite, 2 a state vector, 3 a polynomial in
    place of the elements), the ratio of the ionospheric delay to that on L1, and that of the
    range's variance to one of a single frequency."""
    if isinstance(ephemeris, PreciseOrbit):
        e = ephemeris
        clock = e.toe_s, e.toe_s, e.af0_s, e.af1, 0.0
        return np.array([0.0, e.week, *clock, *e.terms, e.group_delay_s, POLYNOMIAL, 1.0, 1.0])
    if isinstance(ephemeris, StateVector):
        clock = ephemeris.toe_s, ephemeris.toe_s, ephemeris.af0_s, ephemeris.af1, 0.0
        orbit = *ephemeris.r_m, *ephemeris.v_mps, *ephemeris.a_mps2
        rest = KIND - TOE - len(clock) - len(orbit)
        return np.array(
            [0.0, ephemeris.week, *clock, *orbit, *[0.0] * rest, STATE_VECTOR, 1.0, 1.0]
        )
    values = {name: float(getattr(ephemeris, name)) for name in _FIELDS}
    # Both times count from the week of toe; around its start toc may be of the week before.
    values["toc_s"] -= round((values["toc_s"] - values["toe_s"]) / WEEK_S) * WEEK_S
    beidou = ephemeris.satellite[0] == "C"
    still = beidou and int(ephemeris.satellite[1:]) in GEOSTATIONARY
    if beidou:  # convert BeiDou's earth rate and time of week to those of GPS
        own_s = (ephemeris.toe_s - BEIDOU_OFFSET_S) % WEEK_S
        values["omega0_rad"] += (
            GNSS_EARTH_RATE_RPS * ephemeris.toe_s - BEIDOU_EARTH_RATE_RPS * own_s
        )
        values["omega_dot_rps"] += 0.0 if still else GNSS_EARTH_RATE_RPS - BEIDOU_EARTH_RATE_RPS
    mu = GPS_GM_M3PS2 if ephemeris.satellite[0] in "GJ" else WGS84_GM_M3PS2
    kind = GEOSTATIONARY_ORBIT if still else ELEMENTS
    return np.array([mu, float(ephemeris.week), *values.values(), kind, 1.0, 1.0])


def free_share(first_hz: Vector | float, second_hz: Vector | float) -> Vector:
    """The weight of the first range in the ionosphere-free combination; the second has the rest."""
    return np.asarray(1.0 / (1.0 - np.square(second_hz / first_hz)))


def packed_for(
    packed: Vector, ephemeris: Orbit, carrier_hz: float, second_hz: float | None
) -> Vector:
    """A packed ephemeris (26,) for another carrier than L1, or for the ionosphere-free combination
    of its range with a second one.

    The clocks of GPS, QZSS and GLONASS are those of the combination of L1 and L2, Galileo's that of
    E1 and E5b, or E5a by the message, BeiDou's that of B3I alone [1]_ [2]_.
    """
    packed = packed.copy()
    if second_hz is None:
        packed[IONOSPHERE] = (L1_HZ / carrier_hz) ** 2
        packed[GROUP_DELAY] *= carrier_hz != B3I_HZ
        return packed
    share = free_share(carrier_hz, second_hz).item()
    if ephemeris.satellite[0] == "C":
        delay_s = share * packed[GROUP_DELAY]
    elif second_hz == E5A_HZ and isinstance(ephemeris, Ephemeris):
        delay_s = ephemeris.group_delay_s - ephemeris.group_delay_e5a_s
    else:
        delay_s = 0.0
    packed[GROUP_DELAY], packed[IONOSPHERE] = delay_s, 0.0
    packed[NOISE] = share**2 + (1.0 - share) ** 2
    return packed


@compiled
def satellite_states(packed: Vector, week: float, tow_s: float, pseudorange_m: Vector) -> Vector:
    """Satellite positions, velocities and clocks at the time of transmission.

    Parameters
    ----------
    packed : (n, 26), rows of `pack_ephemeris`
    week, tow_s : GPS time of reception on the receiver's clock
    pseudorange_m : (n,)

    Returns
    -------
    (n, 9) : position (3) in m and velocity (3) in m/s, ECEF at the time of transmission; clock
        offset in m (with relativity and group delay) and its rate in m/s; the ratio of the
        ionospheric delay to that on L1.
    """
    out = np.empty((packed.shape[0], STATES))
    for i in range(packed.shape[0]):
        since_toc = (
            (week - packed[i, WEEK]) * WEEK_S
            + tow_s
            - pseudorange_m[i] / SPEED_OF_LIGHT_MPS
            - packed[i, TOC]
        )
        clock = packed[i, AF0] + packed[i, AF1] * since_toc + packed[i, AF2] * since_toc * since_toc
        # The first evaluation used the satellite's clock; the polynomial is in GPS time: repeat.
        since_toc -= clock
        clock = packed[i, AF0] + packed[i, AF1] * since_toc + packed[i, AF2] * since_toc * since_toc
        relativity = 0.0
        if packed[i, KIND] == STATE_VECTOR:
            propagate_state(packed[i, VECTOR : VECTOR + 9], since_toc, out[i])
        elif packed[i, KIND] == POLYNOMIAL:
            _evaluate(packed[i, VECTOR:GROUP_DELAY], since_toc, out[i])
        else:
            relativity = _orbit(packed, i, since_toc + packed[i, TOC] - packed[i, TOE], out)
        out[i, CLOCK] = SPEED_OF_LIGHT_MPS * (clock - packed[i, GROUP_DELAY] + relativity)
        out[i, CLOCK_RATE] = SPEED_OF_LIGHT_MPS * (
            packed[i, AF1] + 2.0 * packed[i, AF2] * since_toc
        )
        out[i, DELAY_SCALE] = packed[i, IONOSPHERE]
    return out


@compiled
def _evaluate(terms: Vector, t_s: float, out: Vector) -> None:
    """Write position and velocity of a polynomial (15,) to out (9,), by Horner's scheme."""
    for axis in range(3):
        r = v = 0.0
        for at in range(len(terms) - 3 + axis, -1, -3):
            v = v * t_s + r
            r = r * t_s + terms[at]
        out[POSITION + axis], out[VELOCITY + axis] = r, v


@compiled
def _orbit(packed: Vector, i: int, t_k: float, out: Vector) -> float:
    """Write position and velocity `t_k` s after toe to row i; returns relativistic clock term."""
    mu, e, sqrt_a = packed[i, MU], packed[i, ECCENTRICITY], packed[i, SQRT_A]
    a = sqrt_a * sqrt_a
    n = math.sqrt(mu / (a * a * a)) + packed[i, DELTA_N]
    mean = packed[i, M0] + n * t_k
    ecc, step, sin_e, cos_e = mean + e * math.sin(mean), 0.0, 0.0, 1.0
    for _ in range(12):
        sin_e, cos_e = math.sin(ecc), math.cos(ecc)
        step = (ecc - e * sin_e - mean) / (1.0 - e * cos_e)
        ecc -= step
        if abs(step) < 1e-8:  # Newton's next step is below double precision
            break
    # Apply the last step to first order instead of evaluating sine and cosine again.
    sin_e, cos_e = sin_e - step * cos_e, cos_e + step * sin_e
    ecc_rate = n / (1.0 - e * cos_e)
    root = math.sqrt(1.0 - e * e)
    phi = math.atan2(root * sin_e, cos_e - e) + packed[i, OMEGA]
    phi_rate = root * ecc_rate / (1.0 - e * cos_e)
    s2, c2 = math.sin(2.0 * phi), math.cos(2.0 * phi)
    u = phi + packed[i, CUS] * s2 + packed[i, CUC] * c2
    u_rate = phi_rate * (1.0 + 2.0 * (packed[i, CUS] * c2 - packed[i, CUC] * s2))
    r = a * (1.0 - e * cos_e) + packed[i, CRS] * s2 + packed[i, CRC] * c2
    r_rate = a * e * sin_e * ecc_rate + 2.0 * phi_rate * (packed[i, CRS] * c2 - packed[i, CRC] * s2)
    inc = packed[i, I0] + packed[i, IDOT] * t_k + packed[i, CIS] * s2 + packed[i, CIC] * c2
    inc_rate = packed[i, IDOT] + 2.0 * phi_rate * (packed[i, CIS] * c2 - packed[i, CIC] * s2)
    node_rate = packed[i, OMEGA_DOT] - (
        0.0 if packed[i, KIND] == GEOSTATIONARY_ORBIT else GNSS_EARTH_RATE_RPS
    )
    node = packed[i, OMEGA0] + node_rate * t_k - GNSS_EARTH_RATE_RPS * packed[i, TOE]
    x, y = r * math.cos(u), r * math.sin(u)
    x_rate = r_rate * math.cos(u) - y * u_rate
    y_rate = r_rate * math.sin(u) + x * u_rate
    so, co, si, ci = math.sin(node), math.cos(node), math.sin(inc), math.cos(inc)
    px, py = x * co - y * ci * so, x * so + y * ci * co
    out[i, POSITION], out[i, POSITION + 1], out[i, POSITION + 2] = px, py, y * si
    vx = x_rate * co - y_rate * ci * so + y * si * so * inc_rate - py * node_rate
    vy = x_rate * so + y_rate * ci * co - y * si * co * inc_rate + px * node_rate
    out[i, VELOCITY], out[i, VELOCITY + 1] = vx, vy
    out[i, VELOCITY + 2] = y_rate * si + y * ci * inc_rate
    if packed[i, KIND] == GEOSTATIONARY_ORBIT:
        _rotate_from_inertial_geo(t_k, out[i])
    relativity: float = (
        -2.0 * math.sqrt(mu) / (SPEED_OF_LIGHT_MPS * SPEED_OF_LIGHT_MPS) * e * sqrt_a * sin_e
    )
    return relativity


@compiled
def _rotate_from_inertial_geo(t_k: float, out: Vector) -> None:
    """Rotate position and velocity of a geostationary satellite to ECEF, in place: its elements
    refer to non-rotating axes tilted by 5 degrees [2]_."""
    rate, tilt = BEIDOU_EARTH_RATE_RPS, -5.0 * math.pi / 180.0
    s, c, st, ct = math.sin(rate * t_k), math.cos(rate * t_k), math.sin(tilt), math.cos(tilt)
    for at in (POSITION, VELOCITY):
        x, y, z = out[at], ct * out[at + 1] + st * out[at + 2], ct * out[at + 2] - st * out[at + 1]
        out[at], out[at + 1], out[at + 2] = c * x + s * y, c * y - s * x, z
    out[VELOCITY] += rate * out[POSITION + 1]
    out[VELOCITY + 1] -= rate * out[POSITION]


@compiled
def geomagnetic_latitude(lat: float, lon: float) -> float:
    """Geomagnetic latitude from latitude and longitude, all in semicircles [1]_."""
    return lat + 0.064 * math.cos((lon - 1.617) * math.pi)


@compiled
def klobuchar_m(
    lat_rad: float, lon_rad: float, az_rad: float, el_rad: float, tow_s: float, coefficients: Vector
) -> float:
    """Ionospheric delay on L1 in m [1]_; `coefficients` (8,) are alpha, then beta."""
    el = el_rad / math.pi
    psi = 0.0137 / (el + 0.11) - 0.022
    lat = lat_rad / math.pi + psi * math.cos(az_rad)
    lat = min(max(lat, -0.416), 0.416)
    lon = lon_rad / math.pi + psi * math.sin(az_rad) / math.cos(lat * math.pi)
    lat_m = geomagnetic_latitude(lat, lon)
    local_s = (4.32e4 * lon + tow_s) % 86400.0
    slant = 1.0 + 16.0 * (0.53 - el) ** 3
    amplitude, period, power = 0.0, 0.0, 1.0
    for i in range(4):
        amplitude += coefficients[i] * power
        period += coefficients[4 + i] * power
        power *= lat_m
    x = 2.0 * math.pi * (local_s - 50400.0) / max(period, 72000.0)
    delay = 5e-9
    if abs(x) < 1.57:
        delay += max(amplitude, 0.0) * (1.0 - x * x / 2.0 + x * x * x * x / 24.0)
    metres: float = SPEED_OF_LIGHT_MPS * slant * delay
    return metres


@compiled
def zenith_delay_m(lat_rad: float, height_m: float) -> float:
    """Tropospheric zenith delay in m, in the standard atmosphere at 50 % humidity [3]_."""
    # The snapshot starts at the earth's centre, where the formulas are not valid.
    if height_m < -1000.0 or height_m > 20000.0:
        return 0.0
    h = max(height_m, 0.0)
    pressure = 1013.25 * (1.0 - 2.2557e-5 * h) ** 5.2568  # hPa
    kelvin = 288.15 - 6.5e-3 * h
    vapour = 6.108 * 0.5 * math.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    dry = 0.0022768 * pressure / (1.0 - 0.00266 * math.cos(2.0 * lat_rad) - 0.00028e-3 * h)
    wet = 0.002277 * (1255.0 / kelvin + 0.05) * vapour
    zenith: float = dry + wet
    return zenith


@compiled
def troposphere_m(zenith_m: float, el_rad: float) -> float:
    """Tropospheric delay in m at an elevation, mapped from the zenith delay [4]_."""
    slant: float = zenith_m * 1.001 / math.sqrt(0.002001 + math.sin(el_rad) ** 2)
    return slant


@compiled
def predict_ranges(
    states: Vector, r_ecef_m: Vector, v_ecef_mps: Vector, tow_s: float, ionosphere: Vector
) -> Vector:
    """Predict pseudoranges and range rates of a receiver with a perfect clock.

    Parameters
    ----------
    states : (n, 9), of `satellite_states`
    r_ecef_m, v_ecef_mps : (3,), of the receiver
    tow_s : seconds of the GPS week
    ionosphere : (8,), Klobuchar coefficients

    Returns
    -------
    (n, 8) : pseudorange in m and its rate in m/s, line of sight, the unit vector to the satellite
        (3) in ECEF at the time of reception, elevation and azimuth in rad, ionospheric delay in m.
    """
    out = np.empty((states.shape[0], PREDICTED))
    lat, lon, height = geodetic_position(r_ecef_m)
    axes, zenith = ned_axes(lat, lon), zenith_delay_m(lat, height)
    d, u = np.empty(3), np.empty(3)
    for i in range(states.shape[0]):
        s, c, rho = 0.0, 1.0, 0.0
        for _ in range(2):  # Sagnac effect: the earth rotates by 5e-6 rad while the signal travels
            d[0] = c * states[i, POSITION] + s * states[i, POSITION + 1] - r_ecef_m[0]
            d[1] = -s * states[i, POSITION] + c * states[i, POSITION + 1] - r_ecef_m[1]
            d[2] = states[i, POSITION + 2] - r_ecef_m[2]
            rho = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
            s = GNSS_EARTH_RATE_RPS * rho / SPEED_OF_LIGHT_MPS
            c = 1.0 - 0.5 * s * s
        vx = c * states[i, VELOCITY] + s * states[i, VELOCITY + 1] - v_ecef_mps[0]
        vy = -s * states[i, VELOCITY] + c * states[i, VELOCITY + 1] - v_ecef_mps[1]
        vz = states[i, VELOCITY + 2] - v_ecef_mps[2]
        for k in range(3):
            u[k] = d[k] / rho
            out[i, LINE_OF_SIGHT + k] = u[k]
        north = axes[0, 0] * u[0] + axes[0, 1] * u[1] + axes[0, 2] * u[2]
        east = axes[1, 0] * u[0] + axes[1, 1] * u[1] + axes[1, 2] * u[2]
        down = axes[2, 0] * u[0] + axes[2, 1] * u[1] + axes[2, 2] * u[2]
        el = math.asin(min(max(-down, -1.0), 1.0))
        az = math.atan2(east, north)
        delay = bent = 0.0
        if el > 0.0:
            delay = troposphere_m(zenith, el)
            bent = states[i, DELAY_SCALE] * klobuchar_m(lat, lon, az, el, tow_s, ionosphere)
        out[i, RANGE] = rho - states[i, CLOCK] + delay + bent
        out[i, DELAY] = bent
        out[i, RATE] = u[0] * vx + u[1] * vy + u[2] * vz - states[i, CLOCK_RATE]
        out[i, ELEVATION] = el
        out[i, AZIMUTH] = az
    return out


def systems_of(system: Indices) -> list[int]:
    """The distinct systems in `system` (n,), by `CLOCK_OF`; the first has no bias."""
    return sorted(set(system.tolist()))


def design_matrix(los: Vector, system: Indices) -> Vector:
    """Geometry (n, 3 + systems) of one epoch: negative lines of sight, clock, systems' biases."""
    columns = [-los, np.ones((len(los), 1))]
    columns += [(system == kind)[:, None].astype(float) for kind in systems_of(system)[1:]]
    return np.hstack(columns)
