"""The fixed-wing vehicle of the simulator.

Controls, in order: elevator, aileron, rudder (-1 to 1 of full deflection; positive is trailing edge
down, right roll, and trailing edge left as in Beard and McLain), throttle (0 to 1).
"""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat, quat_from_euler
from simvehicle.vehicles.contact_kernel import Gear
from simvehicle.vehicles.fixedwing.fixedwing_flight import (
    STATE_SIZE,
    integrate_flight,
    pack_parameters,
)
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero
from simvehicle.vehicles.fixedwing.fixedwing_parameters import (
    FixedWingParameters,
    aero_coefficients,
    read_fixedwing,
    wheel_gear,
)
from simvehicle.vehicles.fixedwing.trim import TrimPoint, find_trim
from simvehicle.vehicles.parameter_file import body_inertia
from simvehicle.vehicles.rigidbody_kernel import Inertia
from simvehicle.vehicles.vehicle import LOAD_SIZE

Array = NDArray[np.float64]


class FixedWing:
    """The parameters in the kernel's form; plant faults give a new object.

    Attributes
    ----------
    parameters : FixedWingParameters
    body, aero, gear
        The kernel's tuples.
    """

    controls_count = 4
    plant_names = (
        "mass_kg_add",
        "inertia_scale",
        "load_shift_x_m",
        "motor_efficiency[0]",
        "propeller_efficiency[0]",
        "elevator_efficiency",
        "aileron_efficiency",
        "rudder_efficiency",
        "battery_voltage_scale",
    )

    def __init__(self, parameters: FixedWingParameters, plant: Mapping[str, float] = {}) -> None:
        self.parameters = parameters
        self.plant = dict(plant)
        self.body: Inertia = body_inertia(parameters, plant)
        self.aero: Aero = aero_coefficients(parameters, plant)
        # Height of the centre of mass when standing on the ground.
        self.standing_height_m = max(point[2] for point in parameters.gear_m)
        self.gear: Gear = wheel_gear(parameters)
        throw = parameters.throw_deg
        self.throw_rad = (
            math.radians(throw.elevator),
            math.radians(throw.aileron),
            math.radians(throw.rudder),
        )
        shift_m = plant.get("load_shift_x_m", 0.0)
        battery = parameters.battery
        supply = battery.supply(
            # A motor model computes the current in the kernel.
            battery.full_throttle_a if parameters.motor is None else 0.0,
            plant.get("battery_voltage_scale", 1.0),
            1.0,
        )
        self.packed = pack_parameters(
            self.body, self.aero, self.gear, supply, shift_m, self.throw_rad
        )

    @classmethod
    def read(cls, name: str | Path) -> "FixedWing":
        """Read a shipped set by name, or a parameter file."""
        return cls(read_fixedwing(name))

    def with_plant(self, plant: Mapping[str, float]) -> "FixedWing":
        """The same airframe with plant faults (`plant_names`)."""
        return FixedWing(self.parameters, plant)

    def trim(self, airspeed_mps: float, density: float, gravity: float) -> TrimPoint:
        """The trim of straight flight at this speed; ValueError if it cannot be flown."""
        return find_trim(airspeed_mps, self.body, self.aero, density, gravity)

    def start(self, r_ned_m: Array, v_b_mps: Array, q_nb: Array) -> Array:
        """State array (14,) at a position, velocity and attitude, battery full."""
        # Body rates and drawn charge start at zero.
        return np.concatenate([r_ned_m, v_b_mps, q_nb, np.zeros(4)])

    def cruise(
        self, r_ned_m: Array, heading_rad: float, wind_ned_mps: Array, speed_mps: float,
        density: float, gravity: float,
    ) -> Array:  # fmt: skip
        """State (14,) of trimmed flight at a position (3,) in a wind (3,).

        Raises
        ------
        ValueError
            If this airspeed cannot be flown.
        """
        point = self.trim(speed_mps, density, gravity)
        q = quat_from_euler(point.roll_rad, point.pitch_rad, heading_rad)
        # Velocity through the air in body axes, plus the wind.
        relative = speed_mps * np.array([math.cos(point.alpha_rad), 0, math.sin(point.alpha_rad)])
        return self.start(r_ned_m, relative + matrix_from_quat(q).T @ wind_ned_mps, q)

    def advance(
        self, x: Array, controls: Array, surroundings: Array, steps: int, dt: float
    ) -> tuple[Array, Array]:
        """Fly `steps` steps of `dt` seconds in `pack_surroundings`.

        Returns
        -------
        x : array, shape (14,)
        load : array, shape (6,)
            Specific force in body axes [m/s^2]; battery voltage [V], current [A], charge 0 to 1.
        """
        after, load = np.empty(STATE_SIZE), np.empty(LOAD_SIZE)
        integrate_flight(x, controls, surroundings, steps, dt, self.packed, after, load)
        return after, load
