"""What the simulation needs of a vehicle; what else there is to a kind, see `kinds`."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIND, GRAVITY, DENSITY, GROUND, BATTERY_SAG = (
    0,
    3,
    6,
    7,
    8,
)  # where they begin in `pack_surroundings`
FORCE, VOLTS, CURRENT, CHARGE, LOAD_SIZE = (
    0,
    3,
    4,
    5,
    6,
)  # and in what `advance` gives beside the state


def pack_surroundings(
    wind_ned_mps: Array, gravity_ned_mps2: Array, density: float, ground_down_m: float
) -> Array:
    """What acts on a vehicle from outside during a step (9,), as the kernels take it.

    `density` is the air's [kg/m^3], `ground_down_m` the ground's down coordinate. The last entry is
    the vehicle's own: its battery's voltage over that of a full pack.
    """
    out = np.empty(9)
    out[WIND : WIND + 3] = wind_ned_mps
    out[GRAVITY : GRAVITY + 3] = gravity_ned_mps2
    out[DENSITY], out[GROUND], out[BATTERY_SAG] = density, ground_down_m, 1.0
    return out


class Vehicle(Protocol):
    """Fixed parameters; the first 13 entries of the state array are those of the rigid body."""

    @property
    def parameters(self) -> Any:
        """The parameter file's content; `cruise_mps` at least."""

    @property
    def controls_count(self) -> int:
        """How many actuators there are."""

    @property
    def plant_names(self) -> Sequence[str]:
        """Names of the plant faults it knows."""

    def with_plant(self, plant: Mapping[str, float]) -> "Vehicle":
        """The same vehicle with plant faults; ValueError if no such body exists."""

    @property
    def standing_height_m(self) -> float:
        """Height of the centre of mass when the ground carries it."""

    def start(self, r_ned_m: Array, v_b_mps: Array, q_nb: Array) -> Array:
        """State (m,) at a position (3,), velocity (3,) and attitude (4,), the rest at rest."""

    def cruise(
        self, r_ned_m: Array, heading_rad: float, wind_ned_mps: Array, speed_mps: float,
        density: float, gravity: float,
    ) -> Array:  # fmt: skip
        """State (m,) of steady flight at (3,) in a wind (3,); ValueError if it cannot be flown."""

    def advance(
        self, x: Array, controls: Array, around: Array, steps: int, dt: float
    ) -> tuple[Array, Array]:
        """State (m,) after so many steps of `dt` seconds in `pack_surroundings`, and what it is
        under then (6,): specific force [m/s^2], battery voltage [V], current [A], charge left (0 to
        1).
        """
