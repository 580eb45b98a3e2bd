"""Ionospheric and tropospheric delays of L1 and E1.

References
----------
.. [1] Klobuchar's model: IS-GPS-200N, 20.3.3.5.2.5 and figure 20-4.
.. [2] Zenith delay: Saastamoinen 1972, with gravity's dependence on latitude and height by Davis
   et al., Radio Science 20(6), 1985; pressure and temperature of the ISA.
.. [3] Mapping to elevation: Black and Eisner 1984, as in RTCA DO-229D, A.4.2.4.
"""

from math import cos, pi, sin, sqrt

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS

DAY_S = 86_400.0
NIGHT_S = 5e-9  # Klobuchar's constant term
HUMIDITY = 0.5  # relative; chosen
SHELL_LATITUDE_MAX = 0.416  # semicircles


@inlined
def ionosphere_m(
    tow_s: float,
    lat_rad: float,
    lon_rad: float,
    elevation_rad: float,
    azimuth_rad: float,
    coefficients: Array,
) -> float:
    """Klobuchar delay [m] of L1 [1]_; `coefficients` (8,) are alpha, then beta.

    The formulas use semicircles.
    """
    elevation = elevation_rad / pi
    angle = 0.0137 / (elevation + 0.11) - 0.022
    lat = lat_rad / pi + angle * cos(azimuth_rad)
    # The model limits the latitude to 75 degrees.
    lat = min(max(lat, -SHELL_LATITUDE_MAX), SHELL_LATITUDE_MAX)
    lon = lon_rad / pi + angle * sin(azimuth_rad) / cos(lat * pi)
    magnetic = lat + 0.064 * cos((lon - 1.617) * pi)
    # The delay peaks at 14 h local time, which is 50400 s.
    local_s = (0.5 * DAY_S * lon + tow_s) % DAY_S
    amplitude = period = 0.0
    # Horner's scheme.
    for k in range(3, -1, -1):
        amplitude = amplitude * magnetic + coefficients[k]
        period = period * magnetic + coefficients[4 + k]
    phase = 2.0 * pi * (local_s - 50_400.0) / max(period, 72_000.0)
    day = 0.0
    # The cosine as a series, as in the document; at night only the constant remains.
    if abs(phase) < 1.57:
        day = max(amplitude, 0.0) * (1.0 - phase**2 / 2.0 + phase**4 / 24.0)
    slant = 1.0 + 16.0 * (0.53 - elevation) ** 3
    return SPEED_OF_LIGHT_MPS * slant * (NIGHT_S + day)


@inlined
def zenith_delay_m(lat_rad: float, height_m: float) -> float:
    """Hydrostatic and wet delay of the zenith [2]_ in the standard atmosphere of 50 % humidity."""
    # The troposphere of the ISA, and with it Saastamoinen's model, ends at 11 km.
    height = min(max(height_m, -1000.0), 11_000.0)
    celsius = 15.0 - 6.5e-3 * height
    kelvin = celsius + 273.15
    pressure_hpa = 1013.25 * (kelvin / 288.15) ** 5.25588
    vapour_hpa = HUMIDITY * 6.1078 * 10.0 ** (7.5 * celsius / (celsius + 237.3))  # Tetens
    gravity = 1.0 - 0.00266 * cos(2.0 * lat_rad) - 0.28e-6 * height
    dry = 0.0022768 * pressure_hpa / gravity
    wet = 0.0022768 * (1255.0 / kelvin + 0.05) * vapour_hpa
    return float(dry + wet)


@inlined
def troposphere_m(lat_rad: float, height_m: float, elevation_rad: float) -> float:
    """Slant delay [m] [2]_ [3]_."""
    mapping = 1.001 / sqrt(0.002001 + sin(elevation_rad) ** 2)
    return zenith_delay_m(lat_rad, height_m) * mapping
