"""The interface between simulation and vehicle; `vehicle_kinds` has the rest of a kind."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import inlined

# Start of each item in `pack_surroundings`, and in the load of `advance`
WIND, GRAVITY, DENSITY, GROUND, BATTERY_SAG, SURROUNDINGS_SIZE = 0, 3, 6, 7, 8, 9
FORCE, VOLTS, CURRENT, CHARGE, LOAD_SIZE = 0, 3, 4, 5, 6


@inlined
def pack_surroundings(
    wind_ned_mps: Array, gravity_ned_mps2: Array, density: float, ground_down_m: float, out: Array
) -> Array:
    """Pack the external conditions of a step into `out` (9,), and return it.

    `density` is that of the air [kg/m^3], `ground_down_m` the ground's down coordinate. The vehicle
    itself sets the last entry: its battery voltage relative to a full pack.
    """
    for i in range(3):
        out[WIND + i] = wind_ned_mps[i]
        out[GRAVITY + i] = gravity_ned_mps2[i]
    out[DENSITY], out[GROUND], out[BATTERY_SAG] = density, ground_down_m, 1.0
    return out


class Vehicle(Protocol):
    """A vehicle's parameters; its state array starts with the 13 states of the rigid body."""

    @property
    def parameters(self) -> Any:
        """The parameter file's content; it has at least `cruise_mps`."""

    @property
    def controls_count(self) -> int:
        """Number of actuators."""

    @property
    def plant_names(self) -> Sequence[str]:
        """Names of the supported plant faults."""

    def with_plant(self, plant: Mapping[str, float]) -> "Vehicle":
        """The same vehicle with plant faults; ValueError if no such rigid body exists."""

    @property
    def standing_height_m(self) -> float:
        """Height of the centre of mass when standing on the ground."""

    def start(self, r_ned_m: Array, v_b_mps: Array, q_nb: Array) -> Array:
        """State (m,) at a position (3,), velocity (3,) and attitude (4,); the rest is zero."""

    def cruise(
        self, r_ned_m: Array, heading_rad: float, wind_ned_mps: Array, speed_mps: float,
        density: float, gravity: float,
    ) -> Array:  # fmt: skip
        """State (m,) of steady flight at a position; ValueError if it cannot be flown."""

    def advance(
        self, x: Array, controls: Array, surroundings: Array, steps: int, dt: float
    ) -> tuple[Array, Array]:
        """State (m,) after `steps` steps of `dt` seconds in `pack_surroundings`, and the load (6,):
        specific force [m/s^2], battery voltage [V], current [A], remaining charge (0 to 1)."""
