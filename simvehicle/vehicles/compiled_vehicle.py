"""A vehicle whose flight is compiled: what the kinds of this package have in common."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from simvehicle.vehicles.parameter_file import VehicleParameters, body_inertia, read_parameters
from simvehicle.vehicles.rigidbody_kernel import RIGID_SIZE, Inertia
from simvehicle.vehicles.vehicle import LOAD_SIZE

Parameters = TypeVar("Parameters", bound=VehicleParameters)


class CompiledVehicle(Generic[Parameters]):
    """The parameters in the form of a compiled flight; plant faults give a new object.

    Attributes
    ----------
    parameters : VehicleParameters
    plant : dict
        The plant faults.
    body : Inertia
    packed : array
        All parameters of `integrate_flight`; a kind sets them.
    further_states : int
        Number of states after those of the rigid body.
    """

    parameter_kind: ClassVar[type[Any]]
    integrate_flight: ClassVar[Callable[..., None]]
    packed: Array
    further_states: int

    def __init__(self, parameters: Parameters, plant: Mapping[str, float] = {}) -> None:
        self.parameters, self.plant = parameters, dict(plant)
        self.body: Inertia = body_inertia(parameters, plant)
        # Height of the centre of mass when standing on the ground.
        self.standing_height_m = max(point[2] for point in parameters.gear_m)

    @classmethod
    def read(cls, name: str | Path) -> Self:
        """Read a shipped set by name (`aerosonde-2025`, `iris`), or a parameter file."""
        return cls(read_parameters(name, cls.parameter_kind))

    def with_plant(self, plant: Mapping[str, float]) -> Self:
        """The same airframe with plant faults (`plant_names`)."""
        return type(self)(self.parameters, plant)

    def start(self, r_ned_m: Array, v_b_mps: Array, q_nb: Array) -> Array:
        """State (m,) at a position, velocity and attitude; motors stopped, battery full."""
        return np.concatenate([r_ned_m, v_b_mps, q_nb, np.zeros(3 + self.further_states)])

    def advance(
        self, x: Array, controls: Array, surroundings: Array, steps: int, dt: float
    ) -> tuple[Array, Array]:
        """State (m,) after `steps` steps of `dt` seconds, and the load; see `Vehicle.advance`."""
        after, load = np.empty(RIGID_SIZE + self.further_states), np.empty(LOAD_SIZE)
        self.integrate_flight(x, controls, surroundings, steps, dt, self.packed, after, load)
        return after, load
