"""The Earth's magnetic field at the scenario's start."""

from datetime import datetime

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.magnetic_field import magnetic_field_gauss


def field_ned_gauss(
    lat_deg: float, lon_deg: float, height_m: float, time: datetime
) -> tuple[float, float, float]:
    """Magnetic field (north, east, down) at a position and time [gauss].

    Raises
    ------
    ConfigError
        If no model covers the time.
    """
    try:
        return magnetic_field_gauss(lat_deg, lon_deg, height_m, time)
    except ValueError:
        raise ConfigError(
            f"start.time = {time:%Y-%m-%d} has no world magnetic model; use 2010 to 2029, "
            "or set sensors.mag.field_ned_gauss"
        ) from None
