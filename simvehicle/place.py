"""From the frame of home to the Earth: geodetic position, local vertical, gravity and air.

The simulation integrates in the Cartesian NED frame of home. Latitude, longitude, height and the
local vertical follow exactly from it, so position, velocity and attitude agree at any distance.
The Earth does not rotate in this model (a gyro at rest reads zero; the true rate is 0.004 deg/s).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from simvehicle.air import standard_air
from simvehicle.compiled import compiled, inlined
from simvehicle.earth import ecef_from_geodetic, geodetic_of, gravity, rot_en

Array = NDArray[np.float64]
_geodetic = cast(Callable[[float, float, float], tuple[float, float, float]], inlined(geodetic_of))
_gravity = cast(Callable[[float, float], float], inlined(gravity))


@dataclass(frozen=True, slots=True)
class Home:
    """Origin of the NED frame: Earth-fixed position (3,) [m] and axes (3, 3)."""

    r_ecef_m: Array
    rot_en: Array
    geoid_m: float

    @classmethod
    def at(cls, lat_deg: float, lon_deg: float, alt_msl_m: float, geoid_m: float) -> "Home":
        """Home at a point; `geoid_m` is the geoid's height above the ellipsoid."""
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        return cls(ecef_from_geodetic(lat, lon, alt_msl_m + geoid_m), rot_en(lat, lon), geoid_m)

    def ned(self, lat_deg: float, lon_deg: float, alt_msl_m: float) -> Array:
        """Position (3,) in the frame of home [m]."""
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        r = ecef_from_geodetic(lat, lon, alt_msl_m + self.geoid_m)
        return np.asarray(self.rot_en.T @ (r - self.r_ecef_m))


@compiled
def locate(
    x: Array, wind: Array, r_ecef: Array, rot: Array, geoid_m: float
) -> tuple[float, float, float, float, float, float, Array]:
    """Everything about a place that the truth needs.

    Parameters
    ----------
    x : array, shape (>= 13,)
        State in the frame of home.
    wind : array, shape (3,)
        NED [m/s].
    r_ecef, rot : arrays, shapes (3,) and (3, 3)
        Of home.
    geoid_m : float

    Returns
    -------
    lat_rad, lon_rad, height_m, pressure_pa, temperature_k, density_kgpm3 : float
    vectors : array, shape (13,)
        Velocity in local NED (3), attitude to local NED (4), velocity relative to the air in body
        axes (3), gravity in the frame of home (3).
    """
    ecef = r_ecef + rot @ x[:3]
    lat, lon, height = _geodetic(ecef[0], ecef[1], ecef[2])
    pressure, temperature, density = standard_air(height - geoid_m)
    sp, cp, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    local = np.array([[-sp * cl, -sp * sl, cp], [-sl, cl, 0.0], [-cp * cl, -cp * sl, -sp]])
    c = local @ rot
    w, a, b, d = x[6], x[7], x[8], x[9]
    body = np.array(
        [
            [1.0 - 2.0 * (b * b + d * d), 2.0 * (a * b - w * d), 2.0 * (a * d + w * b)],
            [2.0 * (a * b + w * d), 1.0 - 2.0 * (a * a + d * d), 2.0 * (b * d - w * a)],
            [2.0 * (a * d - w * b), 2.0 * (b * d + w * a), 1.0 - 2.0 * (a * a + b * b)],
        ]
    )
    out = np.empty(13)
    out[:3] = c @ (body @ x[3:6])
    # The turn between the verticals is small, so its quaternion's scalar part is the large one.
    tw = 0.5 * math.sqrt(1.0 + c[0, 0] + c[1, 1] + c[2, 2])
    ta = (c[2, 1] - c[1, 2]) / (4.0 * tw)
    tb = (c[0, 2] - c[2, 0]) / (4.0 * tw)
    td = (c[1, 0] - c[0, 1]) / (4.0 * tw)
    out[3] = tw * w - ta * a - tb * b - td * d
    out[4] = tw * a + ta * w + tb * d - td * b
    out[5] = tw * b - ta * d + tb * w + td * a
    out[6] = tw * d + ta * b - tb * a + td * w
    out[7:10] = x[3:6] - body.T @ wind
    pull = _gravity(lat, height)
    out[10:] = c[2] * pull
    return lat, lon, height, pressure, temperature, density, out
