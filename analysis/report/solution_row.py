"""One epoch of a position solution, for export to RTKLIB and NMEA files."""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from analysis.results import Decision, FusedState
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.earth import geodetic_from_ecef
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes

GPS_ZERO = datetime(1980, 1, 6, tzinfo=UTC)
NedVector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SolutionRow:
    """A position with its accuracy."""

    gps_time: datetime  # ahead of UTC by the leap seconds
    lat_deg: float
    lon_deg: float
    height_m: float  # above the WGS 84 ellipsoid
    covariance_ned_m2: Vector | None  # (3, 3)
    satellites: tuple[str, ...]  # in use
    velocity_ned_mps: NedVector | None = None
    hdop: float | None = None
    vdop: float | None = None

    @property
    def sigma_ned_m(self) -> NedVector | None:
        """Standard deviations north, east, down; None if unknown."""
        if self.covariance_ned_m2 is None:
            return None
        north, east, down = np.sqrt(np.diag(self.covariance_ned_m2)).tolist()
        return north, east, down


def row_of(state: Decision | FusedState) -> SolutionRow:
    """Convert a decision with a position, or a fused state."""
    r_ecef_m = state.position_ecef_m
    assert r_ecef_m is not None
    lat, lon, height = (float(x) for x in geodetic_from_ecef(r_ecef_m))
    time = GPS_ZERO + timedelta(microseconds=state.t_us)
    place = time, float(np.degrees(lat)), float(np.degrees(lon)), height
    if isinstance(state, FusedState):
        used = (name for name, weight in state.weights.items() if weight > 0.0)
        satellites = tuple(name for name in used if name[1:].isdigit())
        squares = np.diag(np.square(state.position_sigma_m))
        return SolutionRow(*place, squares, satellites, state.velocity_ned_mps)
    covariance = None
    if state.position_covariance_m2 is not None:
        xx, xy, xz, yy, yz, zz = state.position_covariance_m2
        axes = ned_axes(*geodetic_position(np.array(r_ecef_m))[:2])
        covariance = axes @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ axes.T
    satellites = tuple(name for name in state.satellites if name not in state.excluded)
    return SolutionRow(*place, covariance, satellites, hdop=state.hdop, vdop=state.vdop)
