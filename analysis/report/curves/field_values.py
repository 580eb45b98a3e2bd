"""Readers that compute the values of a curve from the columns of a message of any log format.

Columns are arrays by field name, of shape (n,), or (n, k) for an array field of MAVLink.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.rotations.rotation import euler_from_quat, wrap_degrees

Columns = Mapping[str, NDArray[Any]]
Values = NDArray[np.float64]
Reader = Callable[[Columns], Values]

DEG = 180 / np.pi
UNKNOWN_M = 1e6  # u-blox reports an unknown accuracy as 2^32 mm


@dataclass(frozen=True, slots=True)
class LogCurve:
    """One curve: its message, panel, name, reader; of `every` sensor instance or the first only."""

    message: str
    panel: str
    name: str
    values: Reader
    every: bool = True


def values_of(curve: LogCurve, columns: Columns) -> Values | None:
    """The values of a curve; None if a field is missing in this version or has no value."""
    try:
        found = curve.values(columns)
    except KeyError:
        return None
    # A field that is never filled counts as missing.
    return found if np.isfinite(found).any() else None


def column(columns: Columns, name: str) -> Values:
    """One field as floats, of shape (n,) or (n, k)."""
    return np.asarray(columns[name], float)


def field(name: str, scale: float = 1.0, unknown: float | None = None) -> Reader:
    """Values of a field times `scale`; the value `unknown` becomes NaN."""

    def values(columns: Columns) -> Values:
        raw = column(columns, name)
        # Before scaling, as `unknown` is a raw value.
        if unknown is not None:
            raw = np.where(raw == unknown, np.nan, raw)
        return raw * scale

    return values


def element(name: str, i: int, scale: float = 1.0, unknown: float | None = None) -> Reader:
    """One element of a MAVLink array field; all NaN if it is never used."""

    def values(columns: Columns) -> Values:
        raw = column(columns, name)[:, i]

        used = raw.any() if unknown is None else (raw != unknown).any()
        # An unused channel gives no curve instead of zeros.
        if not used:
            return np.full(len(raw), np.nan)
        return np.where(raw == unknown, np.nan, raw) * scale

    return values


def used_field(name: str, scale: float = 1.0) -> Reader:
    """Values of a field; all NaN if it is always 0 or 65535 (not connected)."""

    def values(columns: Columns) -> Values:
        raw = column(columns, name)
        # 65535 means unused in MAVLink and ArduPilot.
        raw = np.where(raw == 65535, np.nan, raw)
        return raw * scale if np.nan_to_num(raw).any() else np.full(len(raw), np.nan)

    return values


def positive_field(name: str, scale: float = 1.0) -> Reader:
    """Values of a field in which 0 or less means unknown."""

    def values(columns: Columns) -> Values:
        raw = column(columns, name)
        return np.where(raw > 0, raw, np.nan) * scale

    return values


def accuracy_field(name: str, scale: float = 1.0) -> Reader:
    """An accuracy in m; NaN if zero or above 1000 km, as receivers without a fix report."""

    def values(columns: Columns) -> Values:
        metres = column(columns, name) * scale
        return np.where((metres > 0) & (metres < UNKNOWN_M), metres, np.nan)

    return values


def angle_field(name: str) -> Reader:
    """Values of a field in radians as degrees."""
    return field(name, DEG)


def heading_field(name: str, scale: float = DEG) -> Reader:
    """A heading in degrees, wrapped to (-180, 180]."""
    return lambda columns: wrap_degrees(column(columns, name) * scale)


def norm(*names: str, scale: float = 1.0) -> Reader:
    """Norm of the vector of several fields."""
    return lambda columns: scale * np.sqrt(sum(column(columns, name) ** 2 for name in names))


def largest_field(*names: str) -> Reader:
    """The largest magnitude of several fields."""
    return lambda columns: np.max([np.abs(column(columns, name)) for name in names], axis=0)


def euler_deg(q: Values) -> tuple[Values, Values, Values]:
    """Roll, pitch and yaw in degrees from quaternions (w, x, y, z), shape (4, n)."""
    roll, pitch, yaw = np.degrees(euler_from_quat(q.T)).T
    return roll, pitch, yaw
