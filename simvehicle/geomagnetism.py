"""The Earth's magnetic field by the world magnetic model (the pygeomag library)."""

from datetime import datetime
from functools import lru_cache

NANOTESLA_PER_GAUSS = 1e5


@lru_cache(maxsize=8)
def field_ned_gauss(
    lat_deg: float, lon_deg: float, height_m: float, time: datetime
) -> tuple[float, float, float]:
    """Field vector at a place and time, north, east, down [gauss]."""
    from pygeomag import GeoMag

    year = time.year + (time.timetuple().tm_yday - 1) / 365.25
    model = GeoMag(base_year=time)
    found = model.calculate(glat=lat_deg, glon=lon_deg, alt=height_m / 1000.0, time=year)
    return (
        found.x / NANOTESLA_PER_GAUSS,
        found.y / NANOTESLA_PER_GAUSS,
        found.z / NANOTESLA_PER_GAUSS,
    )
