"""Pseudoranges and range rates without noise: geometry, clocks and the atmosphere.

P = rho + c (dt_r - dt_s) + I + T. The range rho is c times the signal's time of flight: from the
satellite's position at transmission, expressed in the Earth-fixed frame at reception, which has
rotated meanwhile (Sagnac effect) [1]_.

References
----------
.. [1] IS-GPS-200N, 20.3.3.4.3.4; Ashby, Living Reviews in Relativity 6(1), 2003.
"""

from math import asin, atan2, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled
from mavproxy_fault.numerics.constants import GNSS_EARTH_RATE_RPS, SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.earth_kernel import geodetic_of
from simvehicle.gnss.satellite_orbits import satellite_state
from simvehicle.gnss.signal_delays import ionosphere_m, troposphere_m

FLIGHT_TIME_S = 0.075  # typical; initial value of the iteration
NO_COEFFICIENTS = np.zeros(0)
# Rows of `signal_geometry`; the direction has three.
(RANGE, RANGE_RATE, SAT_CLOCK, SAT_CLOCK_RATE, SAT_ELEVATION, SAT_AZIMUTH, DELAY, LINE_OF_SIGHT) = (
    range(8)
)
GEOMETRY_ROWS = LINE_OF_SIGHT + 3
LOWEST_ELEVATION_RAD = 3.0 * pi / 180.0  # the atmospheric models are not valid below


class Atmosphere(NamedTuple):
    """Atmospheric delays: Klobuchar's coefficients (8,), none without an ionosphere, and whether
    the troposphere acts."""

    coefficients: Array
    troposphere: bool


@compiled
def signal_geometry(
    table: Array,
    tow_s: float,
    r_ecef_m: Array,
    v_ecef_mps: Array,
    coefficients: Array,
    troposphere: bool,
) -> Array:
    """The signals of n satellites received at GPS time `tow_s`, as rows (10, n).

    Range [m] and its rate [m/s], satellite clock error [s] and its rate, elevation and azimuth
    [rad], atmospheric delay [m] (below 3 degrees of elevation that at 3 degrees; empty
    `coefficients` mean no ionosphere), and the unit vector to the satellite, Earth-fixed at
    reception. The position is `r_ecef_m[:3]`. The time of flight comes from two evaluations of the
    orbit, each refined along the velocity; the remaining error is below a micrometre.
    """
    rx, ry, rz = r_ecef_m[0], r_ecef_m[1], r_ecef_m[2]
    lat, lon, height = geodetic_of(rx, ry, rz)
    s_lat, c_lat, s_lon, c_lon = sin(lat), cos(lat), sin(lon), cos(lon)
    out = np.empty((GEOMETRY_ROWS, len(table)))
    for k in range(len(table)):
        flight = FLIGHT_TIME_S
        # The position at transmission depends on the time of flight: iterate.
        for _ in range(2):
            start = flight
            px, py, pz, vx, vy, vz, clock, clock_rate = satellite_state(table[k], tow_s - start)
            for _ in range(3):
                s, c = sin(GNSS_EARTH_RATE_RPS * flight), cos(GNSS_EARTH_RATE_RPS * flight)
                # Extrapolate along the velocity, which is cheaper than evaluating the orbit again.
                earlier = start - flight
                mx, my, mz = px + vx * earlier, py + vy * earlier, pz + vz * earlier
                # Rotate into the Earth-fixed axes at reception.
                x, y = c * mx + s * my, c * my - s * mx
                dx, dy, dz = x - rx, y - ry, mz - rz
                distance = sqrt(dx * dx + dy * dy + dz * dz)
                flight = distance / SPEED_OF_LIGHT_MPS
        ex, ey, ez = dx / distance, dy / distance, dz / distance
        wx, wy = c * vx + s * vy, c * vy - s * vx
        # Positive when the range grows; transmission time changes with the range, too.
        opening = ex * (wx - v_ecef_mps[0]) + ey * (wy - v_ecef_mps[1]) + ez * (vz - v_ecef_mps[2])
        drag = ex * (wx - GNSS_EARTH_RATE_RPS * y) + ey * (wy + GNSS_EARTH_RATE_RPS * x) + ez * vz
        outward = c_lon * ex + s_lon * ey
        north = c_lat * ez - s_lat * outward
        east = c_lon * ey - s_lon * ex
        elevation = asin(min(max(c_lat * outward + s_lat * ez, -1.0), 1.0))
        azimuth = atan2(east, north)
        # Below this elevation both models diverge.
        above = max(elevation, LOWEST_ELEVATION_RAD)
        delay = 0.0
        if len(coefficients):
            delay += ionosphere_m(tow_s, lat, lon, above, azimuth, coefficients)
        if troposphere:
            delay += troposphere_m(lat, height, above)
        out[RANGE, k] = distance
        out[RANGE_RATE, k] = opening / (1.0 + drag / SPEED_OF_LIGHT_MPS)
        out[SAT_CLOCK, k] = clock + clock_rate * (start - flight)
        out[SAT_CLOCK_RATE, k] = clock_rate
        out[SAT_ELEVATION, k], out[SAT_AZIMUTH, k], out[DELAY, k] = elevation, azimuth, delay
        out[LINE_OF_SIGHT, k], out[LINE_OF_SIGHT + 1, k], out[LINE_OF_SIGHT + 2, k] = ex, ey, ez
    return out
