"""The parameter file of a fixed wing, and its conversion to the kernel's tuples."""

import math
from collections.abc import Mapping

import msgspec

from mavproxy_fault.documents.document_check import Section
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero
from simvehicle.vehicles.parameter_file import VehicleParameters


class Wing(Section, frozen=True):
    """Reference area, span, chord and Oswald efficiency."""

    area_m2: float
    span_m: float
    chord_m: float
    oswald: float


class Longitudinal(Section, frozen=True):
    """Lift or pitching-moment coefficients."""

    zero: float
    alpha: float
    q: float
    elevator: float


class Drag(Section, frozen=True):
    """Drag coefficients except induced drag."""

    parasitic: float
    q: float
    elevator: float


class Stall(Section, frozen=True):
    """Blending from linear lift to that of a flat plate."""

    sharpness: float
    alpha_rad: float


class Lateral(Section, frozen=True):
    """Side-force, rolling- or yawing-moment coefficients."""

    zero: float
    beta: float
    p: float
    r: float
    aileron: float
    rudder: float


class ThrustLaw(Section, frozen=True):
    """T = rho S/2 ((k_motor throttle)^2 - Va^2)."""

    disc_m2: float
    k_motor: float
    k_torque: float


class Polynomial(Section, frozen=True):
    """Propeller coefficient as a polynomial in the advance ratio J."""

    zero: float
    j: float
    j2: float


class FixedWingMotor(Section, frozen=True):
    """Direct-current motor and propeller."""

    diameter_m: float
    kv_rpm_per_v: float
    resistance_ohm: float
    no_load_a: float
    supply_v: float
    torque: Polynomial
    thrust: Polynomial


class Throw(Section, frozen=True):
    """Maximum deflections."""

    elevator: float
    aileron: float
    rudder: float


class FixedWingParameters(VehicleParameters, frozen=True):
    """The complete file; it has either `thrust_law` or `motor`."""

    wing: Wing
    lift: Longitudinal
    drag: Drag
    pitch: Longitudinal
    stall: Stall
    side_force: Lateral
    roll: Lateral
    yaw: Lateral
    throw_deg: Throw
    thrust_law: ThrustLaw | None = None
    motor: FixedWingMotor | None = None

    def __post_init__(self) -> None:
        # Two models at once would add their thrusts.
        if (self.thrust_law is None) == (self.motor is None):
            raise ValueError("exactly one of thrust_law and motor is needed")
        super().__post_init__()


def aero_coefficients(parameters: FixedWingParameters, plant: Mapping[str, float]) -> Aero:
    """The kernel's aerodynamic and propulsion coefficients, with plant faults.

    `motor_efficiency[0]` and `propeller_efficiency[0]` scale the thrust, `elevator_efficiency`,
    `aileron_efficiency` and `rudder_efficiency` the surfaces' effect.
    """
    par, wing = parameters, parameters.wing
    surfaces = ("elevator", "aileron", "rudder")
    effects = {name: plant.get(f"{name}_efficiency", 1.0) for name in surfaces}

    def numbers(section: Section) -> list[float]:
        """The coefficients of a section, those of surfaces with their faults."""
        values = msgspec.structs.asdict(section).items()
        return [value * effects.get(name, 1.0) for name, value in values]

    aspect_ratio = wing.span_m**2 / wing.area_m2
    coefficients = (
        *(wing.area_m2, wing.span_m, wing.chord_m),
        *numbers(par.lift),
        1.0 / (math.pi * wing.oswald * aspect_ratio),
        *(*numbers(par.drag), *numbers(par.pitch)),
        par.stall.sharpness,
        math.exp(par.stall.sharpness * par.stall.alpha_rad),
        *(*numbers(par.side_force), *numbers(par.roll), *numbers(par.yaw)),
        *_propulsion(par, plant),
    )
    return Aero._make(coefficients)


def _propulsion(par: FixedWingParameters, plant: Mapping[str, float]) -> tuple[float, ...]:
    """The last 15 entries of `Aero`; the unused propulsion model gets terms without effect."""
    blade = plant.get("propeller_efficiency[0]", 1.0)
    power = plant.get("motor_efficiency[0]", 1.0)
    law, motor = par.thrust_law, par.motor
    if law is not None:
        # Ones where the kernel divides.
        rest = (1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0)
        return (law.disc_m2 * blade, law.k_motor * power, law.k_torque * power, 0.0, *rest)
    assert motor is not None
    # The torque constant equals the inverse of the speed constant in SI units.
    kq = 60.0 / (2.0 * math.pi * motor.kv_rpm_per_v)
    return (
        *(0.0, 0.0, 0.0, 1.0),
        motor.diameter_m,
        *msgspec.structs.astuple(motor.torque),
        *(value * blade for value in msgspec.structs.astuple(motor.thrust)),
        motor.supply_v * power,
        kq,
        motor.resistance_ohm,
        motor.no_load_a,
    )
