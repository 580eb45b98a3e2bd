"""How the values of a curve follow from the columns of a message, whatever log it came from.

Columns are arrays by field name, of shape (n,), or (n, k) for an array field of MAVLink.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.rotations.rotation import euler_from_quat

Columns = Mapping[str, NDArray[Any]]
Values = NDArray[np.float64]
Reader = Callable[[Columns], Values]

DEG = 180 / np.pi
UNKNOWN_M = 1e6  # 2^32 mm is u-blox's "unknown"


@dataclass(frozen=True, slots=True)
class LogCurve:
    """One curve: of which message, in which panel, its name; of `every` instance or the first."""

    message: str
    panel: str
    name: str
    values: Reader
    every: bool = True


def values_of(curve: LogCurve, columns: Columns) -> Values | None:
    """The curve, or None where this version lacks a field of it, or has no value in it."""
    try:
        found = curve.values(columns)
    except KeyError:
        return None
    # A field that is there and never filled is as good as none.
    return found if np.isfinite(found).any() else None


def column(columns: Columns, name: str) -> Values:
    """One field as floats, of shape (n,) or (n, k)."""
    return np.asarray(columns[name], float)


def field(name: str, scale: float = 1.0, unknown: float | None = None) -> Reader:
    """Values of a field times `scale`; the value `unknown` becomes NaN."""

    def values(columns: Columns) -> Values:
        raw = column(columns, name)
        # Before scaling: "unknown" is a count of the wire.
        if unknown is not None:
            raw = np.where(raw == unknown, np.nan, raw)
        return raw * scale

    return values


def element(name: str, i: int, scale: float = 1.0, unknown: float | None = None) -> Reader:
    """One element of an array field of a MAVLink message; NaN throughout if it is never used."""

    def values(columns: Columns) -> Values:
        raw = column(columns, name)[:, i]
        # Read before scaling for the same reason.
        used = raw.any() if unknown is None else (raw != unknown).any()
        # A channel that nobody feeds: no curve is better than one at zero.
        if not used:
            return np.full(len(raw), np.nan)
        return np.where(raw == unknown, np.nan, raw) * scale

    return values


def used_field(name: str, scale: float = 1.0) -> Reader:
    """Values of a field that is zero throughout, or 65535, where nothing is connected."""

    def values(columns: Columns) -> Values:
        raw = column(columns, name)
        # MAVLink's and ArduPilot's "not there" of 16 bits.
        raw = np.where(raw == 65535, np.nan, raw)
        return raw * scale if np.nan_to_num(raw).any() else np.full(len(raw), np.nan)

    return values


def positive_field(name: str, scale: float = 1.0) -> Reader:
    """A value of which 0 or less means that it is unknown."""

    def values(columns: Columns) -> Values:
        raw = column(columns, name)
        return np.where(raw > 0, raw, np.nan) * scale

    return values


def accuracy_field(name: str, scale: float = 1.0) -> Reader:
    """An accuracy, m; receivers without a fix give the earth's size and more, or zero."""

    def values(columns: Columns) -> Values:
        metres = column(columns, name) * scale
        return np.where((metres > 0) & (metres < UNKNOWN_M), metres, np.nan)

    return values


def angle_field(name: str) -> Reader:
    """Values of a field in radians as degrees."""
    return field(name, DEG)


def heading_field(name: str, scale: float = DEG) -> Reader:
    """A heading in degrees, wrapped to (-180, 180]."""
    return lambda columns: 180 - (180 - column(columns, name) * scale) % 360


def norm(*names: str, scale: float = 1.0) -> Reader:
    """Length of the vector that several fields make."""
    return lambda columns: scale * np.sqrt(sum(column(columns, name) ** 2 for name in names))


def largest_field(*names: str) -> Reader:
    """The greatest magnitude among several fields."""
    return lambda columns: np.max([np.abs(column(columns, name)) for name in names], axis=0)


def euler_deg(q: Values) -> tuple[Values, Values, Values]:
    """Roll, pitch and yaw in degrees of quaternions (w, x, y, z), shape (4, n)."""
    roll, pitch, yaw = np.degrees(euler_from_quat(q.T)).T
    return roll, pitch, yaw
