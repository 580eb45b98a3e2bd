"""The multirotor of the simulator: 4 to 8 upright rotors around the centre of mass.

Controls: one per motor, 0 to 1 between idle and full speed, in the order of the parameter file; 0
stops the motor.
"""

import math
from collections.abc import Mapping
from typing import Literal

import msgspec
import numpy as np

from mavproxy_fault.documents.document_check import Section
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3
from mavproxy_fault.wire.plant_names import MOTOR
from simvehicle.vehicles.compiled_vehicle import CompiledVehicle
from simvehicle.vehicles.contact_kernel import Gear, make_gear
from simvehicle.vehicles.multirotor.multirotor_flight import (
    Airframe,
    integrate_flight,
    pack_parameters,
)
from simvehicle.vehicles.parameter_file import VehicleParameters
from simvehicle.vehicles.rigidbody_kernel import RIGID_SIZE


class Rotor(Section, frozen=True):
    """Position forward and right of the centre of mass, and rotation seen from above."""

    x_m: float
    y_m: float
    turns: Literal["ccw", "cw"]


class MultirotorMotor(Section, frozen=True):
    """Motor and propeller, the same for all rotors; rates are those of the rotor [rad/s]."""

    thrust_n_per_rps2: float
    torque_per_thrust_m: float
    idle_rps: float
    full_rps: float
    spin_up_s: float
    spin_down_s: float
    drag_ns2pm: float


class MultirotorParameters(VehicleParameters, frozen=True):
    """The complete file."""

    rotors: list[Rotor]
    motor: MultirotorMotor
    drag_area_m2: float
    damping_nms: float

    def __post_init__(self) -> None:
        if not 4 <= len(self.rotors) <= 8:
            raise ValueError(f"{len(self.rotors)} rotors are not supported; use 4 to 8")
        if not 0.0 <= self.motor.idle_rps < self.motor.full_rps:
            raise ValueError("motor.idle_rps must lie between 0 and motor.full_rps")
        super().__post_init__()


class Multirotor(CompiledVehicle[MultirotorParameters]):
    """The multirotor, with `rotors` (n, 7) as in `multirotor_flight`."""

    parameter_kind = MultirotorParameters
    integrate_flight = staticmethod(integrate_flight)

    def __init__(self, parameters: MultirotorParameters, plant: Mapping[str, float] = {}) -> None:
        super().__init__(parameters, plant)
        self.controls_count = len(parameters.rotors)
        # Motor speeds and angles, current and drawn charge
        self.further_states = 2 * self.controls_count + 2
        body = (parameters.drag_area_m2, parameters.damping_nms)
        shift_m = (plant.get("load_shift_x_m", 0.0), plant.get("load_shift_y_m", 0.0))
        self.frame = Airframe._make((*msgspec.structs.astuple(parameters.motor), *body, *shift_m))
        # Skids: equal friction in both directions.
        self.gear: Gear = make_gear(np.array(parameters.gear_m), parameters.mass_kg, 0.6, 0.6)
        self.rotors = np.array(
            [
                (
                    rotor.x_m,
                    rotor.y_m,
                    1.0 if rotor.turns == "ccw" else -1.0,
                    plant.get(f"propeller_efficiency[{i}]", 1.0),
                    plant.get(f"motor_efficiency[{i}]", 1.0),
                    plant.get(f"rotor_unbalance_kgm[{i}]", 0.0),
                    plant.get(f"thrust_ripple[{i}]", 0.0),
                )
                for i, rotor in enumerate(parameters.rotors)
            ]
        )
        # Lift and moments (4, n) of the rotors per thrust.
        self.thrust_effects = np.array(
            [
                np.ones(self.controls_count),
                -self.rotors[:, 1],
                self.rotors[:, 0],
                self.rotors[:, 2] * parameters.motor.torque_per_thrust_m,
            ]
        )
        supply = parameters.battery.supply(plant)
        self.packed = pack_parameters(self.body, self.frame, self.gear, supply, self.rotors)

    @property
    def plant_names(self) -> tuple[str, ...]:
        """Names of the plant faults that this vehicle supports."""
        each = range(self.controls_count)
        return (
            "mass_kg_add",
            "inertia_scale",
            "load_shift_x_m",
            "load_shift_y_m",
            "battery_voltage_scale",
            "battery_resistance_scale",
            *(f"{name}[{i}]" for name in MOTOR for i in each),
        )

    def cruise(
        self, r_ned_m: Array, heading_rad: float, wind_ned_mps: Array, speed_mps: float,
        density: float, gravity: float,
    ) -> Array:  # fmt: skip
        """State (15 + 2n,) of level hover at a position (3,); wind and speed have no effect."""
        # Level: a rotation by the heading only.
        half = 0.5 * heading_rad
        q = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
        x = self.start(r_ned_m, np.zeros(3), q)
        x[RIGID_SIZE : RIGID_SIZE + self.controls_count] = self.hover_rps(density, gravity)
        return x

    def hover_rps(self, density: float, gravity: float) -> float:
        """Motor speed [rad/s] of hover."""
        # Each motor carries an equal share of the weight.
        each = self.body.mass_kg * gravity / self.controls_count
        thrust = self.parameters.motor.thrust_n_per_rps2 * density / SEA_LEVEL_DENSITY_KGPM3
        # Thrust is proportional to the square of the speed.
        return math.sqrt(each / thrust)
