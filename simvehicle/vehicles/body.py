"""Controls and truth of a vehicle."""

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Controls:
    """Actuator commands; motors 0 to 1, surfaces -1 to 1 of full throw."""

    values: Vector
    armed: bool = True


class Truth(msgspec.Struct, frozen=True, gc=False):
    """What was really so at one instant; everything a sensor may look at.

    A struct and not a dataclass, as one is made at every step and that costs a tenth of the time.

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
