"""What the simulation needs of a vehicle; what else there is to a kind, see `kinds`."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
        """State at a position, velocity and attitude, the rest at rest."""

    def cruise(
        self, r_ned_m: Array, heading_rad: float, wind_ned_mps: Array, speed_mps: float,
        density: float, gravity: float,
    ) -> Array:  # fmt: skip
        """State of steady flight; ValueError if it cannot be flown."""

    def advance(
        self, x: Array, controls: Array, wind_ned_mps: Array, gravity_ned_mps2: Array,
        density: float, ground_down_m: float, steps: int, dt: float,
    ) -> tuple[Array, Array]:  # fmt: skip
        """State later, and specific force (3), battery voltage, current and rest then."""
