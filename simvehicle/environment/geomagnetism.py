"""The magnetic field at the scenario's start, or a line that says why there is none."""

from datetime import datetime

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.magnetic_field import magnetic_field_gauss


def field_ned_gauss(
    lat_deg: float, lon_deg: float, height_m: float, time: datetime
) -> tuple[float, float, float]:
    """Field vector at a place and time, north, east, down [gauss].

    Raises
    ------
    ConfigError
        If no model covers the time.
    """
    try:
        return magnetic_field_gauss(lat_deg, lon_deg, height_m, time)
    except ValueError:
        raise ConfigError(
            f"start.time = {time:%Y-%m-%d} has no world magnetic model; 2010 to 2029 is allowed, "
            "or sensors.mag.field_ned_gauss says the field"
        ) from None
