"""One epoch of a solution, as the files for other programs need it."""

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
    """A position with what tells how good it is.

    Attributes
    ----------
    gps_time : datetime
        On GPS's time scale, which is ahead of UTC by the leap seconds.
    height_m : float
        Above the ellipsoid.
    sigma_ned_m : tuple or None
        One sigma north, east, down; None where nothing bounds the position.
    satellites : tuple of str
        Those in use.
    velocity_ned_mps : tuple or None
        None where the solution has none.
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
    """The row of a decision that has a position, or of a fused state."""
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
        # Without what correlates the axes, which a decision does not hold.
        north, east, down = np.sqrt(axes**2 @ np.square(state.position_sigma_m)).tolist()
        sigma = north, east, down
    satellites = tuple(name for name in state.satellites if name not in state.excluded)
    return SolutionRow(*place, sigma, satellites, hdop=state.hdop, vdop=state.vdop)
