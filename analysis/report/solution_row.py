"""One epoch of a position solution, for export to RTKLIB and NMEA files."""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np

from analysis.results import Decision, FusedState
from mavproxy_fault.numerics.earth import geodetic_from_ecef
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes

GPS_ZERO = datetime(1980, 1, 6, tzinfo=UTC)
NedVector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SolutionRow:
    """A position with its accuracy.

    Attributes
    ----------
    gps_time : datetime
        In GPS time, which is ahead of UTC by the leap seconds.
    height_m : float
        Above the WGS 84 ellipsoid.
    sigma_ned_m : tuple or None
        Standard deviations north, east, down; None if unknown.
    satellites : tuple of str
        The satellites in use.
    velocity_ned_mps : tuple or None
        None if the solution has no velocity.
    """

    gps_time: datetime
    lat_deg: float
    lon_deg: float
    height_m: float
    sigma_ned_m: NedVector | None
    satellites: tuple[str, ...]
    velocity_ned_mps: NedVector | None = None
    hdop: float | None = None
    vdop: float | None = None


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
        return SolutionRow(*place, state.position_sigma_m, satellites, state.velocity_ned_mps)
    sigma = None
    if state.position_sigma_m is not None:
        axes = ned_axes(*geodetic_position(np.array(r_ecef_m))[:2])
        # Neglects correlations between the axes, which a decision does not hold.
        north, east, down = np.sqrt(axes**2 @ np.square(state.position_sigma_m)).tolist()
        sigma = north, east, down
    satellites = tuple(name for name in state.satellites if name not in state.excluded)
    return SolutionRow(*place, sigma, satellites, hdop=state.hdop, vdop=state.vdop)
