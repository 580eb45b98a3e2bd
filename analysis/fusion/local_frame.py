"""The local frame of the graph: east, north, up at an anchor, in metres."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import gtsam
import numpy as np

from analysis.detection.filter.inertial import gravity_ecef
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.earth_kernel import geodetic_position, local_axes
from mavproxy_fault.numerics.magnetic_field import date_of, magnetic_field_gauss


@dataclass(frozen=True)
class LocalFrame:
    """An anchor (3,) in ECEF, rows (3, 3) east, north, up there, and the stamp it was set at."""

    anchor_m: Vector
    axes: Vector
    stamp_us: int

    @cached_property
    def pose(self) -> Any:
        """This frame in ECEF as a GTSAM pose."""
        return gtsam.Pose3(gtsam.Rot3(self.axes.T), self.anchor_m)

    def local(self, r_ecef_m: Vector) -> Vector:
        """A position (3,) in this frame."""
        return np.asarray(self.axes @ (r_ecef_m - self.anchor_m))

    def ecef(self, r_m: Vector) -> Vector:
        """A position (3,) of this frame in ECEF."""
        return np.asarray(self.anchor_m + self.axes.T @ r_m)

    def gravity(self, r_m: Vector) -> Vector:
        """Gravity (3,) at a position of this frame."""
        return np.asarray(self.axes @ gravity_ecef(self.ecef(r_m)))

    @cached_property
    def field_gauss(self) -> Vector:
        """Magnetic field (3,), NED, in gauss, at the frame's origin on the day of the stamp."""
        lat, lon, height = geodetic_position(self.anchor_m)
        lat_deg, lon_deg = float(np.degrees(lat)), float(np.degrees(lon))
        day = date_of(self.stamp_us)
        north, east, down = magnetic_field_gauss(lat_deg, lon_deg, float(height), day)
        # The model gives north, east, down; this frame is east, north, up.
        return np.array([east, north, -down])


def frame_at(r_ecef_m: Vector, stamp_us: int) -> LocalFrame:
    """The frame anchored at a position (3,) at a stamp."""
    north, east, down = local_axes(r_ecef_m)
    return LocalFrame(r_ecef_m.copy(), np.array([east, north, -down]), stamp_us)
