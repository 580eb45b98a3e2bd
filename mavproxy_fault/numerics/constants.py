"""Constants that several parts share, each with its source; SI units.

Kernels of numba freeze them when they are compiled.
"""

# CGPM 1901, resolution 3: the standard acceleration of gravity, by definition.
STANDARD_GRAVITY_MPS2 = 9.80665

# SI: by definition of the metre.
SPEED_OF_LIGHT_MPS = 299_792_458.0

# NGA.STND.0036, World Geodetic System 1984, version 1.0.0, 2014: tables 3.1 and 3.5.
WGS84_SEMI_MAJOR_M = 6_378_137.0
WGS84_FLATTENING = 1.0 / 298.257223563
WGS84_ECCENTRICITY2 = WGS84_FLATTENING * (2.0 - WGS84_FLATTENING)

# IS-GPS-200, table 20-IV, and the Galileo OS SIS ICD, table 59: for broadcast orbits.
GNSS_EARTH_RATE_RPS = 7.2921151467e-5
