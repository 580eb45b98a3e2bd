"""The multirotor of the simulator: 4 to 8 upright rotors around the centre of mass.

Controls: one per motor, 0 to 1 between idle and full speed, in the order of the parameter file; 0
stops the motor.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3
from simvehicle.vehicles.contact_kernel import Gear, make_gear
from simvehicle.vehicles.multirotor.multirotor_flight import (
    Airframe,
    integrate_flight,
    pack_parameters,
)
from simvehicle.vehicles.parameter_file import (
    BatteryParameters,
    InertiaMoments,
    body_inertia,
    read_parameters,
)
from simvehicle.vehicles.rigidbody_kernel import RIGID_SIZE
from simvehicle.vehicles.vehicle import LOAD_SIZE

Array = NDArray[np.float64]


class Rotor(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Position forward and right of the centre of mass, and rotation seen from above."""

    x_m: float
    y_m: float
    turns: Literal["ccw", "cw"]


class MultirotorMotor(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Motor and propeller, the same for all rotors; rates are those of the rotor [rad/s]."""

    thrust_n_per_rps2: float
    torque_per_thrust_m: float
    idle_rps: float
    full_rps: float
    spin_up_s: float
    spin_down_s: float
    drag_ns2pm: float


class MultirotorParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The complete file."""

    name: str
    source: str
    mass_kg: float
    inertia_kgm2: InertiaMoments
    rotors: list[Rotor]
    motor: MultirotorMotor
    drag_area_m2: float
    damping_nms: float
    gear_m: list[tuple[float, float, float]]
    battery: BatteryParameters
    cruise_mps: float

    def __post_init__(self) -> None:
        if not 4 <= len(self.rotors) <= 8:
            raise ValueError(f"{len(self.rotors)} rotors are not supported; use 4 to 8")
        if not 0.0 <= self.motor.idle_rps < self.motor.full_rps:
            raise ValueError("motor.idle_rps must lie between 0 and motor.full_rps")
        body_inertia(self, {})  # refuses impossible moments of inertia


class Multirotor:
    """The parameters in the form of the compiled flight; plant faults give a new object."""

    def __init__(self, parameters: MultirotorParameters, plant: Mapping[str, float] = {}) -> None:
        self.parameters = parameters
        self.controls_count = len(parameters.rotors)
        motor = parameters.motor
        self.body = body_inertia(parameters, plant)
        self.frame = Airframe(
            motor.thrust_n_per_rps2,
            motor.torque_per_thrust_m,
            motor.idle_rps,
            motor.full_rps,
            motor.spin_up_s,
            motor.spin_down_s,
            motor.drag_ns2pm,
            parameters.drag_area_m2,
            parameters.damping_nms,
            plant.get("load_shift_x_m", 0.0),
            plant.get("load_shift_y_m", 0.0),
        )
        # Height of the centre of mass when standing on the ground.
        self.standing_height_m = max(point[2] for point in parameters.gear_m)
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
                )
                for i, rotor in enumerate(parameters.rotors)
            ]
        )
        battery = parameters.battery
        supply = battery.supply(
            battery.full_throttle_a,
            plant.get("battery_voltage_scale", 1.0),
            plant.get("battery_resistance_scale", 1.0),
        )
        self.packed = pack_parameters(self.body, self.frame, self.gear, supply, self.rotors)

    @classmethod
    def read(cls, name: str | Path) -> "Multirotor":
        """Read a shipped set by name (`iris`, `hexa`), or a parameter file."""
        return cls(read_parameters(name, MultirotorParameters))

    def with_plant(self, plant: Mapping[str, float]) -> "Multirotor":
        """The same airframe with plant faults."""
        return Multirotor(self.parameters, plant)

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
            *(f"motor_efficiency[{i}]" for i in each),
            *(f"propeller_efficiency[{i}]" for i in each),
        )

    def start(self, r_ned_m: Array, v_b_mps: Array, q_nb: Array) -> Array:
        """State array (15 + n,) with stopped motors and a full battery."""
        # Motor speeds, current and drawn charge are zero.
        return np.concatenate([r_ned_m, v_b_mps, q_nb, np.zeros(5 + self.controls_count)])

    def cruise(
        self, r_ned_m: Array, heading_rad: float, wind_ned_mps: Array, speed_mps: float,
        density: float, gravity: float,
    ) -> Array:  # fmt: skip
        """State (15 + n,) of level hover at a position (3,); wind and speed have no effect."""
        # Level: a rotation by the heading only.
        half = 0.5 * heading_rad
        q = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
        x = self.start(r_ned_m, np.zeros(3), q)
        x[RIGID_SIZE:-2] = self.hover_rps(density, gravity)
        return x

    def hover_rps(self, density: float, gravity: float) -> float:
        """Motor speed [rad/s] of hover."""
        # Each motor carries an equal share of the weight.
        each = self.body.mass_kg * gravity / self.controls_count
        thrust = self.parameters.motor.thrust_n_per_rps2 * density / SEA_LEVEL_DENSITY_KGPM3
        # Thrust is proportional to the square of the speed.
        return math.sqrt(each / thrust)

    def advance(
        self, x: Array, controls: Array, surroundings: Array, steps: int, dt: float
    ) -> tuple[Array, Array]:
        """Fly `steps` steps of `dt` seconds in `pack_surroundings`.

        Returns
        -------
        x : array, shape (15 + n,)
        load : array, shape (6,)
            Specific force in body axes [m/s^2]; battery voltage [V], current [A], charge 0 to 1.
        """
        after, load = np.empty(len(x)), np.empty(LOAD_SIZE)
        integrate_flight(x, controls, surroundings, steps, dt, self.packed, after, load)
        return after, load
