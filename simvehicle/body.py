"""State, controls and truth of a vehicle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class State:
    """Rigid body against a local NED frame fixed at home.

    r_ned_m (3,), v_b_mps (3,) over ground in body axes, q_nb (4,) body to NED as (w, x, y, z),
    omega_b_rps (3,); `internal` holds what the vehicle adds (motor speeds, charge drawn).
    """

    r_ned_m: Vector
    v_b_mps: Vector
    q_nb: Vector
    omega_b_rps: Vector
    internal: Vector


@dataclass(frozen=True, slots=True)
class Controls:
    """Actuator commands; motors 0 to 1, surfaces -1 to 1 of full throw."""

    values: Vector
    armed: bool = True


@dataclass(frozen=True, slots=True)
class Truth:
    """What was really so at one instant; everything a sensor may look at.

    `t_us` counts from the start of the simulation. Geodetic height is above the WGS 84 ellipsoid,
    `alt_msl_m` above mean sea level. Wind and velocities over ground are NED, the air's velocity
    relative to the body is `v_air_b_mps`.
    """

    t_us: int
    lat_rad: float
    lon_rad: float
    height_m: float
    alt_msl_m: float
    height_agl_m: float
    r_ned_m: Vector
    v_ned_mps: Vector
    q_nb: Vector
    omega_b_rps: Vector
    specific_force_b_mps2: Vector
    v_air_b_mps: Vector
    wind_ned_mps: Vector
    pressure_pa: float
    temperature_k: float
    density_kgpm3: float
    battery_v: float
    battery_a: float
    battery_remaining: float
    on_ground: bool = False
