"""The Earth's magnetic field by the World Magnetic Model (the pygeomag library)."""

from datetime import UTC, datetime, timedelta
from functools import lru_cache

NANOTESLA_PER_GAUSS = 1e5
UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MODELLED_US = (1_262_304_000_000_000, 1_893_456_000_000_000)  # 2010 up to 2030 in Unix time
UNKNOWN_DATE = datetime(2025, 1, 1, tzinfo=UTC)  # the newest model's epoch


def date_of(stamp_us: int) -> datetime:
    """Return the date of a Unix timestamp; 1 January 2025 for a clock that counts from boot.

    The same date is used for years outside all models. Timestamps in GPS time would give a date
    ten years early, but recordings with GPS time have no magnetometer.
    """
    first_us, end_us = MODELLED_US
    if not first_us <= stamp_us < end_us:
        return UNKNOWN_DATE
    return UNIX_EPOCH + timedelta(days=stamp_us // 86_400_000_000)


@lru_cache(maxsize=8)
def magnetic_field_gauss(
    lat_deg: float, lon_deg: float, height_m: float, time: datetime
) -> tuple[float, float, float]:
    """Return the field vector at a place and time, NED [gauss].

    Raises
    ------
    ValueError
        If no model covers the time.
    """
    from pygeomag import GeoMag

    year = time.year + (time.timetuple().tm_yday - 1) / 365.25
    model = GeoMag(base_year=time)
    found = model.calculate(glat=lat_deg, glon=lon_deg, alt=height_m / 1000.0, time=year)
    return (
        found.x / NANOTESLA_PER_GAUSS,
        found.y / NANOTESLA_PER_GAUSS,
        found.z / NANOTESLA_PER_GAUSS,
    )
