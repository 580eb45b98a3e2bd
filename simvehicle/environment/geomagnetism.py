"""The Earth's magnetic field by the world magnetic model (the pygeomag library)."""

from datetime import datetime
from functools import lru_cache

from mavproxy_fault.documents.errors import ConfigError

NANOTESLA_PER_GAUSS = 1e5


@lru_cache(maxsize=8)
def field_ned_gauss(
    lat_deg: float, lon_deg: float, height_m: float, time: datetime
) -> tuple[float, float, float]:
    """Field vector at a place and time, north, east, down [gauss].

    Raises
    ------
    ConfigError
        If no model covers the time.
    """
    from pygeomag import GeoMag

    year = time.year + (time.timetuple().tm_yday - 1) / 365.25
    try:
        model = GeoMag(base_year=time)
        found = model.calculate(glat=lat_deg, glon=lon_deg, alt=height_m / 1000.0, time=year)
    except ValueError:
        raise ConfigError(
            f"start.time = {time:%Y-%m-%d} has no world magnetic model; 2010 to 2029 is allowed, "
            "or sensors.mag.field_ned_gauss says the field"
        ) from None
    return (
        found.x / NANOTESLA_PER_GAUSS,
        found.y / NANOTESLA_PER_GAUSS,
        found.z / NANOTESLA_PER_GAUSS,
    )
