"""Positions, velocities and clocks of GPS and Galileo satellites from broadcast ephemerides.

The user algorithms of IS-GPS-200N, table 20-IV, and the Galileo OS SIS ICD 2.1, table 66, which
differ in one constant; velocities are their time derivatives.
"""

from collections.abc import Sequence
from math import atan2, cos, sin, sqrt

import msgspec
import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple
from numpy.typing import NDArray

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.constants import (
    GNSS_EARTH_RATE_RPS,
    GPS_GM_M3PS2,
    SPEED_OF_LIGHT_MPS,
    WGS84_GM_M3PS2,
)
from mavproxy_fault.rinex.gps_clock import WEEK_S
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris

State8 = tuple[float, float, float, float, float, float, float, float]

MU_M3PS2 = {"G": GPS_GM_M3PS2, "E": WGS84_GM_M3PS2}
ROW_SIZE = 20  # columns of an orbit table, in the order of `_orbit_row`
KEPLER_STEPS = 4  # Newton: error below 1e-14 rad at the eccentricity 0.16 of E14 and E18


class Orbits(msgspec.Struct, frozen=True):
    """The ephemerides of n satellites as one table (n, 20), the input of `satellite_state`, with
    times in seconds of one GPS week."""

    satellites: tuple[str, ...]
    table: Array


def tabulate_orbits(ephemerides: Sequence[Ephemeris], week: int) -> Orbits:
    """Convert ephemerides to a table, with times in seconds of GPS week `week`."""
    table = np.array([_orbit_row(e, week) for e in ephemerides], dtype=float).reshape(-1, ROW_SIZE)
    return Orbits(tuple(e.satellite for e in ephemerides), table)


def select_orbits(orbits: Orbits, pick: NDArray[np.intp]) -> Orbits:
    """The satellites at the indices `pick` (m,)."""
    return Orbits(tuple(orbits.satellites[k] for k in pick), orbits.table[pick])


def _orbit_row(e: Ephemeris, week: int) -> tuple[float, ...]:
    """Orbital elements in the order of `satellite_state`, with derived constants."""
    # All times count from one week, so that a week rollover needs no special case.
    shift_s = (e.week - week) * WEEK_S
    toc_s = e.toc_s - round((e.toc_s - e.toe_s) / WEEK_S) * WEEK_S  # of the nearest week
    mu = MU_M3PS2[e.satellite[0]]
    a_m = e.sqrt_a**2
    return (
        e.toe_s + shift_s,
        e.m0_rad,
        sqrt(mu / a_m**3) + e.delta_n_rps,
        e.eccentricity,
        a_m,
        e.omega_rad,
        e.cus_rad,
        e.cuc_rad,
        e.crs_m,
        e.crc_m,
        e.cis_rad,
        e.cic_rad,
        e.i0_rad,
        e.idot_rps,
        # The node refers to the start of the week: subtract the Earth's rotation until toe.
        e.omega0_rad - GNSS_EARTH_RATE_RPS * e.toe_s,
        e.omega_dot_rps - GNSS_EARTH_RATE_RPS,
        toc_s + shift_s,
        # The broadcast clock is for two frequencies; L1 alone differs by the group delay.
        e.af0_s - e.group_delay_s,
        e.af1,
        e.af2_per_s,
    )


@inlined
def satellite_state(row: Array, tow_s: float) -> State8:
    """Position (3) and velocity (3), Earth-fixed at `tow_s`, clock and clock rate of one satellite.

    The clock is the satellite's minus GPS time on L1 or E1 [s]: polynomial, relativity and group
    delay. `row` (20,) is a row of `Orbits.table`.
    """
    (
        toe, m0, motion, e, a, omega, cus, cuc, crs, crc, cis, cic, i0, idot, node0, node_rate,
        toc, af0, af1, af2,
    ) = to_fixed_tuple(row, ROW_SIZE)  # fmt: skip
    t = tow_s - toe
    mean = m0 + motion * t
    # Kepler's equation, starting from the first term of the series.
    anomaly = mean + e * sin(mean)
    for _ in range(KEPLER_STEPS):
        anomaly -= (anomaly - e * sin(anomaly) - mean) / (1.0 - e * cos(anomaly))
    se, ce = sin(anomaly), cos(anomaly)
    scale = 1.0 - e * ce
    anomaly_rate = motion / scale
    root = sqrt(1.0 - e * e)

    argument = atan2(root * se, ce - e) + omega
    argument_rate = anomaly_rate * root / scale
    s2, c2 = sin(2.0 * argument), cos(2.0 * argument)
    # Second harmonic corrections of argument, radius and inclination.
    u = argument + cus * s2 + cuc * c2
    r = a * scale + crs * s2 + crc * c2
    i = i0 + idot * t + cis * s2 + cic * c2
    u_rate = argument_rate * (1.0 + 2.0 * (cus * c2 - cuc * s2))
    r_rate = a * e * se * anomaly_rate + 2.0 * argument_rate * (crs * c2 - crc * s2)
    i_rate = idot + 2.0 * argument_rate * (cis * c2 - cic * s2)

    x, y = r * cos(u), r * sin(u)
    x_rate = r_rate * cos(u) - y * u_rate
    y_rate = r_rate * sin(u) + x * u_rate
    si, ci = sin(i), cos(i)
    node = node0 + node_rate * t
    sn, cn = sin(node), cos(node)
    flat = y * ci
    flat_rate = y_rate * ci - y * si * i_rate
    px, py, pz = x * cn - flat * sn, x * sn + flat * cn, y * si
    vx = x_rate * cn - flat_rate * sn - node_rate * py
    vy = x_rate * sn + flat_rate * cn + node_rate * px
    vz = y_rate * si + flat * i_rate

    age = tow_s - toc
    # Relativistic clock correction of an eccentric orbit: 20 ns at e = 0.01.
    relativity = -2.0 * motion * a * a * e / SPEED_OF_LIGHT_MPS**2
    clock = af0 + age * (af1 + age * af2) + relativity * se
    clock_rate = af1 + 2.0 * age * af2 + relativity * ce * anomaly_rate
    return px, py, pz, vx, vy, vz, clock, clock_rate
