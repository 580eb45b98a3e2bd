"""The aircraft of a search without a scenario: a fixed wing, or a quadrotor."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.fixedwing_flight import ELEVATOR, THROTTLE
from simvehicle.vehicles.fixedwing.trim import PITCH
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.multirotor.sway_kernel import MOTOR_COUNT
from simvehicle.vehicles.parameter_file import parameter_document
from simvehicle.vehicles.rigidbody_kernel import U, W

Airframe = FixedWing | Multirotor


def has_rotors(name: str) -> bool:
    """Whether a parameter set is a multirotor's; raises like `read_airframe`."""
    data: Any = parameter_document(name).data
    return isinstance(data, Mapping) and "rotors" in data


def read_airframe(name: str) -> Airframe:
    """Read a shipped parameter set by name, or a file by its path.

    Raises
    ------
    ConfigError
        If it does not exist, its content is wrong, or it has not four rotors.
    """
    if not has_rotors(name):
        return FixedWing.read(name)
    quad = Multirotor.read(name)
    if quad.controls_count != MOTOR_COUNT:
        raise ConfigError(f"vehicle = {name} has {quad.controls_count} rotors; use one with four")
    return quad


def trim_values(airframe: Airframe, density_kgpm3: float) -> dict[str, float]:
    """Defaults of a test file's open values: straight flight at cruising speed, or hover."""
    if isinstance(airframe, Multirotor):
        names = ("initial.u_mps", "initial.w_mps", "initial.pitch_deg", "controls.elevator_deg",
                 "controls.throttle", "mission.pitch_deg", "mission.airspeed_mps")  # fmt: skip
        return dict.fromkeys(names, 0.0)
    trim = airframe.trim(airframe.parameters.cruise_mps, density_kgpm3, STANDARD_GRAVITY_MPS2)
    state, controls = trim.state12(), trim.controls()
    return {
        "initial.u_mps": float(state[U]),
        "initial.w_mps": float(state[W]),
        "initial.pitch_deg": float(np.degrees(state[PITCH])),
        "controls.elevator_deg": float(np.degrees(controls[ELEVATOR])),
        "controls.throttle": float(controls[THROTTLE]),
        "mission.pitch_deg": float(np.degrees(state[PITCH])),
        "mission.airspeed_mps": trim.airspeed_mps,
    }
