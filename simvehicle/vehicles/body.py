"""Controls and truth of a vehicle."""

from dataclasses import dataclass

import msgspec

from mavproxy_fault.numerics.arrays import Array


@dataclass(frozen=True, slots=True)
class Controls:
    """Actuator commands; motors 0 to 1, surfaces -1 to 1 of full throw."""

    values: Array
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
    r_ned_m: Array
    v_ned_mps: Array
    q_nb: Array
    omega_b_rps: Array
    specific_force_b_mps2: Array
    v_air_b_mps: Array
    wind_ned_mps: Array
    pressure_pa: float
    temperature_k: float
    density_kgpm3: float
    battery_v: float
    battery_a: float
    battery_remaining: float
    on_ground: bool = False
