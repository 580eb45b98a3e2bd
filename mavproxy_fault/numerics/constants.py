"""Shared physical constants in SI units, each with its source.

Numba kernels fix their values at compilation.
"""

# CGPM 1901, resolution 3: the standard acceleration of gravity, by definition.
STANDARD_GRAVITY_MPS2 = 9.80665

# SI: by definition of the metre.
SPEED_OF_LIGHT_MPS = 299_792_458.0

# NGA.STND.0036, World Geodetic System 1984, version 1.0.0, 2014: tables 3.1 and 3.5.
WGS84_SEMI_MAJOR_M = 6_378_137.0
WGS84_FLATTENING = 1.0 / 298.257223563
WGS84_ECCENTRICITY2 = WGS84_FLATTENING * (2.0 - WGS84_FLATTENING)

# The same document, table 3.1; the Galileo OS SIS ICD 2.1 and BDS-SIS-ICD-B1I 3.0 give it too.
WGS84_GM_M3PS2 = 3.986004418e14

# Mean radius by the International Union of Geodesy and Geophysics, rounded to a kilometre, for
# conversions of small angles to metres where a relative error of 1/300 does not matter.
MEAN_EARTH_RADIUS_M = 6_371_000.0

# IS-GPS-200N, table 20-IV: GPS orbits are fitted with this value of 1984.
GPS_GM_M3PS2 = 3.986005e14

# IS-GPS-200N, table 20-IV, and the Galileo OS SIS ICD 2.1, section 5.1.1: for broadcast orbits.
GNSS_EARTH_RATE_RPS = 7.2921151467e-5

# CGCS2000, BDS-SIS-ICD-B1I 3.0, section 5.2.4.12.
BEIDOU_EARTH_RATE_RPS = 7.2921150e-5

# IS-GPS-200N, 3.3.1.1, and the Galileo OS SIS ICD 2.1, table 2: GPS L1 and Galileo E1.
L1_HZ = 1575.42e6

# ISO 2533:1975, the standard atmosphere at mean sea level.
SEA_LEVEL_DENSITY_KGPM3 = 1.225
