"""Shared by the GNSS tests: a truth at a position, and a configuration without errors."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from simvehicle.gnss.gnss_config import ClockConfig, GnssConfig
from simvehicle.vehicles.body import Truth

HOME = (math.radians(47.397742), math.radians(8.545594))
UNDULATION_M = 47.0


def _truth_at(
    t_us: int = 0,
    lat_rad: float = HOME[0],
    lon_rad: float = HOME[1],
    height_m: float = 535.0,
    v_ned_mps: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Truth:
    zero = np.zeros(3)
    return Truth(
        t_us=t_us,
        lat_rad=lat_rad,
        lon_rad=lon_rad,
        height_m=height_m,
        alt_msl_m=height_m - UNDULATION_M,
        height_agl_m=0.0,
        r_ned_m=zero,
        v_ned_mps=np.array(v_ned_mps),
        q_nb=np.array([1.0, 0.0, 0.0, 0.0]),
        omega_b_rps=zero,
        specific_force_b_mps2=zero,
        v_air_b_mps=zero,
        wind_ned_mps=zero,
        pressure_pa=95_000.0,
        temperature_k=285.0,
        density_kgpm3=1.16,
        battery_v=16.0,
        battery_a=0.0,
        battery_remaining=1.0,
    )


@pytest.fixture
def truth_at() -> Callable[..., Truth]:
    """A truth at rest over Zurich by default."""
    return _truth_at


@pytest.fixture
def home() -> tuple[float, float]:
    """Latitude and longitude [rad] of that truth."""
    return HOME


@pytest.fixture
def perfect() -> GnssConfig:
    """Every error switched off."""
    return GnssConfig(
        ionosphere=False,
        troposphere=False,
        cn0_sigma_db=0.0,
        thermal=0.0,
        multipath=0.0,
        orbit_m=0.0,
        clock=ClockConfig(offset_s=0.0, drift=0.0, h0_s=0.0, h2_hz=0.0, galileo_offset_m=0.0),
    )
