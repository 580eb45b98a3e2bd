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
    """The exact state of the vehicle at one instant, from which all sensors are sampled.

    A struct instead of a dataclass, as one is created at every step at a tenth of the cost.

    `t_us` counts from the start of the simulation. `height_m` is above the WGS 84 ellipsoid,
    `alt_msl_m` above mean sea level. Wind and velocity over ground are NED; `v_air_b_mps` is the
    body's velocity relative to the air.
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
