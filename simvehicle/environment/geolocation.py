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

from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.earth import ecef_from_geodetic, gravity, rot_en
from mavproxy_fault.numerics.earth_kernel import geodetic_of
from mavproxy_fault.numerics.rotation_kernel import to_body, to_ned
from simvehicle.environment.air import standard_air

Array = NDArray[np.float64]
_gravity = cast(Callable[[float, float], float], inlined(gravity))


@dataclass(frozen=True, slots=True)
class Home:
    """Origin of the NED frame: Earth-fixed position (3,) [m] and axes (3, 3)."""

    r_ecef_m: Array
    rot_en: Array
    geoid_m: float

    @property
    def packed(self) -> Array:
        """Position, axes row by row and geoid (13,), as `locate` reads them."""
        return np.array([*self.r_ecef_m, *self.rot_en.ravel(), self.geoid_m])

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
def locate(x: Array, wind: Array, home: Array, out: Array) -> None:
    """Everything about a place that the truth needs.

    Parameters
    ----------
    x : array, shape (>= 13,)
        State in the frame of home.
    wind : array, shape (3,)
        NED [m/s].
    home : array, shape (13,)
        `Home.packed`.
    out : array, shape (19,)
        Becomes latitude, longitude [rad], height above the ellipsoid [m], pressure [Pa],
        temperature [K] and density [kg/m^3]; velocity in local NED (3), attitude to local NED (4),
        velocity relative to the air in body axes (3), gravity in the frame of home (3).
    """
    n, e, d = x[0], x[1], x[2]
    lat, lon, height = geodetic_of(
        home[0] + home[3] * n + home[4] * e + home[5] * d,
        home[1] + home[6] * n + home[7] * e + home[8] * d,
        home[2] + home[9] * n + home[10] * e + home[11] * d,
    )
    out[0], out[1], out[2] = lat, lon, height
    out[3], out[4], out[5] = standard_air(height - home[12])
    sp, cp, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    # Rows of north, east and down here, against those of home: the vertical tilts on the way.
    local = ((-sp * cl, -sp * sl, cp), (-sl, cl, 0.0), (-cp * cl, -cp * sl, -sp))
    c = np.empty((3, 3))  # from the frame of home to local NED
    for i in range(3):
        for j in range(3):
            c[i, j] = (
                local[i][0] * home[3 + j] + local[i][1] * home[6 + j] + local[i][2] * home[9 + j]
            )
    w, a, b, g = x[6], x[7], x[8], x[9]
    vn, ve, vd = to_ned(w, a, b, g, x[3], x[4], x[5])
    wx, wy, wz = to_body(w, a, b, g, wind[0], wind[1], wind[2])
    # The turn between the verticals is small, so its quaternion's scalar part is the large one.
    tw = 0.5 * math.sqrt(1.0 + c[0, 0] + c[1, 1] + c[2, 2])
    ta = (c[2, 1] - c[1, 2]) / (4.0 * tw)
    tb = (c[0, 2] - c[2, 0]) / (4.0 * tw)
    tg = (c[1, 0] - c[0, 1]) / (4.0 * tw)
    out[9] = tw * w - ta * a - tb * b - tg * g
    out[10] = tw * a + ta * w + tb * g - tg * b
    out[11] = tw * b - ta * g + tb * w + tg * a
    out[12] = tw * g + ta * b - tb * a + tg * w
    out[13], out[14], out[15] = x[3] - wx, x[4] - wy, x[5] - wz
    # Along the local down, given in the axes of home in which the vehicle is integrated.
    pull = _gravity(lat, height)
    for i in range(3):
        out[6 + i] = c[i, 0] * vn + c[i, 1] * ve + c[i, 2] * vd
        out[16 + i] = c[2, i] * pull
