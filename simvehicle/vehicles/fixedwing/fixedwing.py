"""The fixed-wing vehicle of the simulator.

Controls, in order: elevator, aileron, rudder (-1 to 1 of full deflection; positive is trailing edge
down, right roll, and trailing edge left as in Beard and McLain), throttle (0 to 1).
"""

import math
from collections.abc import Mapping

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat, quat_from_euler
from simvehicle.vehicles.compiled_vehicle import CompiledVehicle
from simvehicle.vehicles.contact_kernel import Gear, make_gear
from simvehicle.vehicles.fixedwing.fixedwing_flight import (
    STATE_SIZE,
    integrate_flight,
    pack_parameters,
)
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero
from simvehicle.vehicles.fixedwing.fixedwing_parameters import (
    FixedWingParameters,
    aero_coefficients,
)
from simvehicle.vehicles.fixedwing.trim import TrimPoint, find_trim
from simvehicle.vehicles.rigidbody_kernel import RIGID_SIZE


class FixedWing(CompiledVehicle[FixedWingParameters]):
    """The fixed wing; `aero` and `gear` are the kernel's tuples."""

    parameter_kind = FixedWingParameters
    integrate_flight = staticmethod(integrate_flight)
    further_states = STATE_SIZE - RIGID_SIZE
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
        super().__init__(parameters, plant)
        self.aero: Aero = aero_coefficients(parameters, plant)
        # Wheels: low friction along the body, high friction across it.
        self.gear: Gear = make_gear(np.array(parameters.gear_m), parameters.mass_kg, 0.05, 0.8)
        throw = parameters.throw_deg
        self.throw_rad = (
            math.radians(throw.elevator),
            math.radians(throw.aileron),
            math.radians(throw.rudder),
        )
        shift_m = plant.get("load_shift_x_m", 0.0)
        supply = parameters.battery.supply(plant)
        if parameters.motor is not None:  # its model computes the current in the kernel
            supply = supply._replace(full_throttle_a=0.0)
        self.packed = pack_parameters(
            self.body, self.aero, self.gear, supply, shift_m, self.throw_rad
        )

    def trim(self, airspeed_mps: float, density: float, gravity: float) -> TrimPoint:
        """The trim of straight flight at this speed; ValueError if it cannot be flown."""
        return find_trim(airspeed_mps, self.body, self.aero, density, gravity)

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
        wind_mps = (matrix_from_quat(q) * np.asarray(wind_ned_mps)[:, None]).sum(axis=0)
        return self.start(r_ned_m, relative + wind_mps, q)
