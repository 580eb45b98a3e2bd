"""Shared by the GNSS tests: the sensor over a home, and the states of satellites."""

import numpy as np

from simvehicle.gnss.constellation import build_constellation
from simvehicle.gnss.gnss_config import GnssConfig
from simvehicle.gnss.gnss_sensor import GnssSensor
from simvehicle.gnss.satellite_orbits import Orbits, satellite_state


def gnss_sensor(config: GnssConfig, lat_rad: float, lon_rad: float) -> GnssSensor:
    return GnssSensor(config, build_constellation(config, lat_rad, lon_rad))


def satellite_states(
    orbits: Orbits, tow_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions and velocities (n, 3), clocks and their rates (n,)."""
    states = [satellite_state(row, t) for row, t in zip(orbits.table, tow_s, strict=True)]
    out = np.array(states)
    return out[:, :3], out[:, 3:6], out[:, 6], out[:, 7]
