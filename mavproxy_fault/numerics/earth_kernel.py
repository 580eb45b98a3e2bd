"""Coordinate conversions of single positions for compiled callers; formulas in `earth`."""

from collections.abc import Callable
from math import cos, sin
from typing import cast

import numpy as np

from mavproxy_fault.numerics import earth
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, inlined

_Coordinates = Callable[[float, float, float], tuple[float, float, float]]

# The formulas accept scalars and arrays, so they only need compiling.
geodetic_of = cast(_Coordinates, inlined(earth.geodetic_of))
ecef_of = cast(_Coordinates, inlined(earth.ecef_of))


@compiled
def geodetic_position(r_ecef_m: Array) -> tuple[float, float, float]:
    """Convert an ECEF position (3,) [m] to latitude, longitude [rad] and height [m]."""
    return geodetic_of(r_ecef_m[0], r_ecef_m[1], r_ecef_m[2])


@compiled
def ned_axes(lat_rad: float, lon_rad: float) -> Array:
    """Return the matrix (3, 3) whose rows are north, east and down in ECEF axes."""
    sl, cl = sin(lat_rad), cos(lat_rad)
    so, co = sin(lon_rad), cos(lon_rad)
    out = np.zeros((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = -sl * co, -sl * so, cl
    out[1, 0], out[1, 1] = -so, co
    out[2, 0], out[2, 1], out[2, 2] = -cl * co, -cl * so, -sl
    return out


def local_axes(r_ecef_m: Array) -> Array:
    """Return `ned_axes` (3, 3) at an ECEF position (3,) [m]."""
    lat_rad, lon_rad, _ = geodetic_position(r_ecef_m)
    return ned_axes(lat_rad, lon_rad)
