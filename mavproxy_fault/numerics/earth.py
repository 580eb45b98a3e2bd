"""The Earth as WGS 84: geodetic, Earth-fixed and local coordinates, and gravity.

Source: NGA.STND.0036, World Geodetic System 1984, version 1.0.0, 2014. Latitude and longitude in
rad, heights above the ellipsoid in m. Functions work on the last axis of arrays of any shape.
"""

import numpy as np
from numpy.typing import ArrayLike

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.constants import (
    WGS84_ECCENTRICITY2,
    WGS84_FLATTENING,
    WGS84_SEMI_MAJOR_M,
)

SEMI_MINOR_M = WGS84_SEMI_MAJOR_M * (1.0 - WGS84_FLATTENING)
_GRAVITY_EQUATOR_MPS2 = 9.7803253359
_SOMIGLIANA_K = 0.00193185265241
_GRAVITY_M = 0.00344978650684  # omega^2 a^2 b / mu


def curvature_radii(lat_rad: ArrayLike) -> tuple[Array, Array]:
    """Return the radii of curvature in the meridian and in the prime vertical [m]."""
    w2 = 1.0 - WGS84_ECCENTRICITY2 * np.sin(lat_rad) ** 2
    prime = WGS84_SEMI_MAJOR_M / np.sqrt(w2)
    return np.asarray(prime * (1.0 - WGS84_ECCENTRICITY2) / w2), np.asarray(prime)


def ecef_from_geodetic(lat_rad: ArrayLike, lon_rad: ArrayLike, height_m: ArrayLike) -> Array:
    """Convert geodetic coordinates to ECEF positions (..., 3) [m]."""
    lat, lon, height = np.broadcast_arrays(
        np.asarray(lat_rad, dtype=float),
        np.asarray(lon_rad, dtype=float),
        np.asarray(height_m, dtype=float),
    )
    return np.stack(ecef_of(lat, lon, height), axis=-1)


def ecef_of(lat_rad: Array, lon_rad: Array, height_m: Array) -> tuple[Array, Array, Array]:
    """Convert geodetic coordinates to ECEF x, y, z [m]; scalars or arrays (n,), also compiled."""
    s = np.sin(lat_rad)
    prime = WGS84_SEMI_MAJOR_M / np.sqrt(1.0 - WGS84_ECCENTRICITY2 * s * s)
    across = (prime + height_m) * np.cos(lat_rad)
    z = (prime * (1.0 - WGS84_ECCENTRICITY2) + height_m) * s
    return across * np.cos(lon_rad), across * np.sin(lon_rad), z


def geodetic_of(x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Convert ECEF coordinates [m] to latitude, longitude [rad] and height [m].

    Bowring's iteration on the reduced latitude (Survey Review 23, 1976); after three iterations
    the error is below a nanometre up to 10,000 km. Scalars or arrays (n,), also compiled.
    """
    p = np.sqrt(x * x + y * y)
    second = WGS84_ECCENTRICITY2 / (1.0 - WGS84_ECCENTRICITY2)
    reduced = np.arctan2(WGS84_SEMI_MAJOR_M * z, SEMI_MINOR_M * p)
    lat = reduced
    for _ in range(3):
        s = np.sin(reduced)
        c = np.cos(reduced)
        lat = np.arctan2(
            z + second * SEMI_MINOR_M * s * s * s,
            p - WGS84_ECCENTRICITY2 * WGS84_SEMI_MAJOR_M * c * c * c,
        )
        reduced = np.arctan2((1.0 - WGS84_FLATTENING) * np.sin(lat), np.cos(lat))
    s = np.sin(lat)
    height = (
        p * np.cos(lat) + z * s - WGS84_SEMI_MAJOR_M * np.sqrt(1.0 - WGS84_ECCENTRICITY2 * s * s)
    )
    return lat, np.arctan2(y, x), height


def geodetic_from_ecef(r_ecef_m: ArrayLike) -> tuple[Array, Array, Array]:
    """Convert ECEF positions (..., 3) [m] to latitude, longitude [rad] and height [m]."""
    r = np.asarray(r_ecef_m, dtype=float)
    return geodetic_of(r[..., 0], r[..., 1], r[..., 2])


def rot_en(lat_rad: ArrayLike, lon_rad: ArrayLike) -> Array:
    """Return the matrix (..., 3, 3) that rotates local NED vectors to ECEF axes."""
    sp, cp = np.sin(lat_rad), np.cos(lat_rad)
    sl, cl = np.sin(lon_rad), np.cos(lon_rad)
    zero = np.zeros_like(sp * sl)
    rows = [
        [-sp * cl, -sl + zero, -cp * cl],
        [-sp * sl, cl + zero, -cp * sl],
        [cp + zero, zero, -sp + zero],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def gravity(lat_rad: ArrayLike, height_m: ArrayLike) -> Array:
    """Return normal gravity along the vertical [m/s^2]: Somigliana, second order in height.

    Scalars or arrays, also compiled.
    """
    s2 = np.sin(lat_rad) ** 2
    surface = (
        _GRAVITY_EQUATOR_MPS2 * (1.0 + _SOMIGLIANA_K * s2) / np.sqrt(1.0 - WGS84_ECCENTRICITY2 * s2)
    )
    h = np.divide(height_m, WGS84_SEMI_MAJOR_M)
    free_air = (
        1.0
        - 2.0 * (1.0 + WGS84_FLATTENING + _GRAVITY_M - 2.0 * WGS84_FLATTENING * s2) * h
        + 3.0 * h * h
    )
    return np.multiply(surface, free_air)
