"""The Earth's coordinates one place at a time, for compiled callers; `earth` has the formulas."""

from collections.abc import Callable
from math import cos, sin
from typing import cast

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics import earth
from mavproxy_fault.numerics.compile import compiled, inlined

Vector = NDArray[np.float64]
_Coordinates = Callable[[float, float, float], tuple[float, float, float]]

# The formulas serve arrays and scalars alike, so that compiling them is all they need.
geodetic_of = cast(_Coordinates, inlined(earth.geodetic_of))
ecef_of = cast(_Coordinates, inlined(earth.ecef_of))


@compiled
def geodetic_position(r_ecef_m: Vector) -> tuple[float, float, float]:
    """Latitude and longitude in rad and ellipsoidal height in m of a place (3,) in ECEF."""
    return geodetic_of(r_ecef_m[0], r_ecef_m[1], r_ecef_m[2])


@compiled
def ned_axes(lat_rad: float, lon_rad: float) -> Vector:
    """Rows (3, 3): north, east and down in ECEF."""
    sl, cl = sin(lat_rad), cos(lat_rad)
    so, co = sin(lon_rad), cos(lon_rad)
    out = np.zeros((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = -sl * co, -sl * so, cl
    out[1, 0], out[1, 1] = -so, co
    out[2, 0], out[2, 1], out[2, 2] = -cl * co, -cl * so, -sl
    return out
