"""From the home NED frame to the Earth: geodetic position, local vertical, gravity and air.

The simulation integrates in the Cartesian NED frame at home. Latitude, longitude, height and the
local vertical follow exactly from it, so position, velocity and attitude agree at any distance.
The Earth does not rotate in this model (a gyro at rest reads zero; the true rate is 0.004 deg/s).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.earth import ecef_from_geodetic, gravity, rot_en
from mavproxy_fault.numerics.earth_kernel import geodetic_of
from mavproxy_fault.numerics.rotations.rotation_kernel import to_body, to_ned
from simvehicle.environment.air import standard_air
from simvehicle.vehicles.rigidbody_kernel import DOWN, E0, E1, E2, E3, EAST, NORTH, U, V, W

# Start of each item in the output of `locate_state`, after the geodetic position; its length
AIR, VELOCITY, ATTITUDE, AIR_VELOCITY, LOCAL_GRAVITY, LOCATION_SIZE = 3, 6, 9, 13, 16, 19
_AXES, GEOID, HOME_SIZE = 3, 12, 13  # in `HomeFrame.packed`, after the position
_gravity = cast(Callable[[float, float], float], inlined(gravity))


@dataclass(frozen=True, slots=True)
class HomeFrame:
    """The home NED frame: its origin (3,) [m] and axes (3, 3), both Earth-fixed."""

    r_ecef_m: Array
    rot_en: Array
    geoid_m: float

    @property
    def packed(self) -> Array:
        """Position, axes by rows and geoid (13,), as `locate_state` reads them."""
        return np.array([*self.r_ecef_m, *self.rot_en.ravel(), self.geoid_m])

    @classmethod
    def at(cls, lat_deg: float, lon_deg: float, alt_msl_m: float, geoid_m: float) -> "HomeFrame":
        """The frame at a point; `geoid_m` is the geoid's height above the ellipsoid."""
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        return cls(ecef_from_geodetic(lat, lon, alt_msl_m + geoid_m), rot_en(lat, lon), geoid_m)

    def ned(self, lat_deg: float, lon_deg: float, alt_msl_m: float) -> Array:
        """Position (3,) in the home frame [m]."""
        lat, lon = math.radians(lat_deg), math.radians(lon_deg)
        r = ecef_from_geodetic(lat, lon, alt_msl_m + self.geoid_m)
        return np.asarray((self.rot_en * (r - self.r_ecef_m)[:, None]).sum(axis=0))


@compiled
def locate_state(x: Array, wind: Array, home: Array, out: Array) -> None:
    """Compute position, velocity, attitude, air and gravity at the vehicle for the truth.

    Parameters
    ----------
    x : array, shape (>= 13,)
        State in the home frame.
    wind : array, shape (3,)
        NED [m/s].
    home : array, shape (13,)
        `HomeFrame.packed`.
    out : array, shape (19,)
        Set to latitude, longitude [rad], height above the ellipsoid [m], pressure [Pa],
        temperature [K] and density [kg/m^3]; velocity in local NED (3), attitude to local NED (4),
        velocity relative to the air in body axes (3), gravity in the home frame (3).
    """
    n, e, d, u, v, w = x[NORTH], x[EAST], x[DOWN], x[U], x[V], x[W]
    e0, e1, e2, e3 = x[E0], x[E1], x[E2], x[E3]
    axes = home[_AXES:GEOID].reshape(3, 3)
    lat, lon, height = geodetic_of(
        home[0] + axes[0, 0] * n + axes[0, 1] * e + axes[0, 2] * d,
        home[1] + axes[1, 0] * n + axes[1, 1] * e + axes[1, 2] * d,
        home[2] + axes[2, 0] * n + axes[2, 1] * e + axes[2, 2] * d,
    )
    out[0], out[1], out[2] = lat, lon, height
    out[AIR], out[AIR + 1], out[AIR + 2] = standard_air(height - home[GEOID])
    sp, cp, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    # Local north, east and down as rows; the vertical tilts with the distance from home.
    local = ((-sp * cl, -sp * sl, cp), (-sl, cl, 0.0), (-cp * cl, -cp * sl, -sp))
    c = np.empty((3, 3))  # from the home frame to local NED
    for i in range(3):
        for j in range(3):
            c[i, j] = local[i][0] * axes[0, j] + local[i][1] * axes[1, j] + local[i][2] * axes[2, j]
    vn, ve, vd = to_ned(e0, e1, e2, e3, u, v, w)
    wx, wy, wz = to_body(e0, e1, e2, e3, wind[0], wind[1], wind[2])
    # The rotation between the verticals is small, so the scalar part of its quaternion is large.
    t0 = 0.5 * math.sqrt(1.0 + c[0, 0] + c[1, 1] + c[2, 2])
    t1 = (c[2, 1] - c[1, 2]) / (4.0 * t0)
    t2 = (c[0, 2] - c[2, 0]) / (4.0 * t0)
    t3 = (c[1, 0] - c[0, 1]) / (4.0 * t0)
    out[ATTITUDE] = t0 * e0 - t1 * e1 - t2 * e2 - t3 * e3
    out[ATTITUDE + 1] = t0 * e1 + t1 * e0 + t2 * e3 - t3 * e2
    out[ATTITUDE + 2] = t0 * e2 - t1 * e3 + t2 * e0 + t3 * e1
    out[ATTITUDE + 3] = t0 * e3 + t1 * e2 - t2 * e1 + t3 * e0
    out[AIR_VELOCITY] = u - wx
    out[AIR_VELOCITY + 1] = v - wy
    out[AIR_VELOCITY + 2] = w - wz
    # Along the local down axis, in the home frame.
    pull = _gravity(lat, height)
    for i in range(3):
        out[VELOCITY + i] = c[i, 0] * vn + c[i, 1] * ve + c[i, 2] * vd
        out[LOCAL_GRAVITY + i] = c[2, i] * pull
