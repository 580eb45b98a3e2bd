"""Linearise the actuator response of a scenario's vehicle about steady flight.

The vehicle is held in steady flight until its motors have followed the commands; the acceleration
of the last step is their effect. All values are in the channels of HIL_ACTUATOR_CONTROLS.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from analysis.detection.actuators.effects import (
    AIRSPEED,
    ANGULAR,
    COMMANDS,
    CONSTANT,
    FORCE,
    FORWARD,
    FORWARD_BY_AIRSPEED,
    OUTPUT,
    RATE,
    TERMS,
    THROTTLE,
    Effects,
)
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.constants import (
    SEA_LEVEL_DENSITY_KGPM3,
    STANDARD_GRAVITY_MPS2,
)
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat
from simvehicle.hil.actuator_commands import actuator_channels
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.simulation.vehicle_kinds import find_vehicle_kind
from simvehicle.vehicles.rigidbody_kernel import E0, RIGID_SIZE, P, U
from simvehicle.vehicles.vehicle import SURROUNDINGS_SIZE, pack_surroundings

STEPS, STEP_S = 30, 5e-3  # 0.15 s, six time constants of a slow motor
HEIGHT_M = 100.0  # free of ground contact
# Small against manoeuvres, large against rounding; chosen
COMMAND_STEP, RATE_STEP_RPS, SPEED_STEP_MPS = 0.05, 0.05, 0.5
HALVINGS, LEVELS = 12, 11
LEAST_SLOPE = 0.02  # of the largest slope: an axis with less is not the throttle's
FORCE_X, FORCE_Y, FORCE_Z = range(ANGULAR, 6)  # after the angular accelerations
BODY_AXES = 6
MIN_WING_HZ = 0.1  # m/s^2 per m/s of cross flow; chosen: below it the vehicle has no wing


class _TrimmedVehicle:
    """A vehicle held in steady flight at sea level."""

    def __init__(self, vehicle: Any, names: list[str]) -> None:
        self._vehicle = vehicle
        self._zero = np.zeros(3)
        gravity = np.array([0.0, 0.0, STANDARD_GRAVITY_MPS2])
        self._around = np.empty(SURROUNDINGS_SIZE)
        pack_surroundings(self._zero, gravity, SEA_LEVEL_DENSITY_KGPM3, 0.0, self._around)
        speed_mps = vehicle.parameters.cruise_mps
        position = np.array([0.0, 0.0, -HEIGHT_M])
        self._state = vehicle.cruise(
            position, 0.0, self._zero, speed_mps, SEA_LEVEL_DENSITY_KGPM3, STANDARD_GRAVITY_MPS2
        )
        self.trim = self._trim(names)

    def motion(self, commands: Array, change: Array) -> Array:
        """Return angular acceleration and specific force (6,) for commands (n,), with the body
        state changed by `change` (13,)."""
        motion: Array = self._motions(commands, change)[-1]
        return motion

    def lag_s(self, number: int) -> float:
        """Return the lag of an actuator [s]: the mean delay of its step response."""
        step, zero = 0.0 * self.trim, np.zeros(RIGID_SIZE)
        step[number] = COMMAND_STEP
        rise = self._motions(self.trim + step, zero) - self._motions(self.trim - step, zero)
        total = float(rise[-1] @ rise[-1])
        if total == 0.0:  # an actuator without effect
            return 0.0
        # Rounding must not make the lag of an immediate response negative.
        return max(float((1.0 - rise @ rise[-1] / total).sum() * STEP_S), 0.0)

    def throttle_counts(self, number: int, rows: list[int], slopes: Array) -> Array:
        """Return what commands from 0 to 1 count on the axes (n, LEVELS) of `slopes` (n,)."""
        levels, commands = np.linspace(0.0, 1.0, LEVELS), self.trim.copy()
        moved = np.empty((len(rows), LEVELS))
        for i, commands[number] in enumerate(levels):
            moved[:, i] = self.motion(commands, np.zeros(RIGID_SIZE))[rows]
        known = (np.abs(slopes) > LEAST_SLOPE * np.abs(slopes).max())[:, None]
        slope = np.where(known, slopes[:, None], 1.0)
        return np.where(known, (moved - moved[:, :1]) / slope, levels)

    def _motions(self, commands: Array, change: Array) -> Array:
        """Return the motion (STEPS, 6) after each step since the commands changed."""
        state = self._state.copy()
        body = state[:RIGID_SIZE] + change
        motions = np.empty((STEPS, BODY_AXES))
        for row in motions:
            state[:RIGID_SIZE] = body
            state, load = self._vehicle.advance(state, commands, self._around, 1, STEP_S)
            row[:ANGULAR] = (state[P:RIGID_SIZE] - body[P:RIGID_SIZE]) / STEP_S
            row[ANGULAR:] = load[:3]
        return motions

    def _trim(self, names: list[str]) -> Array:
        """Return commands (n,) of steady flight: centred surfaces, and motors that balance weight
        or drag."""
        motors = 1.0 - _surfaces(names)
        axis, sign = (0, 1.0) if THROTTLE in names else (2, -1.0)
        q = self._state[E0 : E0 + 4]
        needed_mps2 = -sign * STANDARD_GRAVITY_MPS2 * matrix_from_quat(q)[2, axis]
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            force = self.motion(middle * motors, np.zeros(RIGID_SIZE))[ANGULAR:]
            sufficient = sign * force[axis] > needed_mps2
            low, high = (low, middle) if sufficient else (middle, high)
        return high * motors


def vehicle_effects(scenario: Scenario) -> Effects:
    """Compute the actuator effects of a scenario's vehicle."""
    kind = find_vehicle_kind(scenario.vehicle.kind)
    vehicle = kind.read(scenario.vehicle.parameters)
    names = kind.actuators(vehicle)
    trimmed = _TrimmedVehicle(vehicle, names)

    def by_state(entry: int, step: float) -> Array:
        return _slope(lambda change: trimmed.motion(trimmed.trim, change), RIGID_SIZE, entry, step)

    def by_command(number: int, step: float) -> Array:
        at_rest = np.zeros(RIGID_SIZE)
        return _slope(
            lambda change: trimmed.motion(trimmed.trim + change, at_rest), len(names), number, step
        )

    coefficients, mix = np.zeros((BODY_AXES, TERMS)), np.zeros((COMMANDS, COMMANDS))
    lags_s = np.zeros(COMMANDS)
    for i, outputs in enumerate(actuator_channels(names)[:COMMANDS]):
        coefficients[:, OUTPUT + i] = by_command(i, COMMAND_STEP)
        lags_s[i] = trimmed.lag_s(i)
        channels = [pair for pair in outputs if pair[0] < COMMANDS]
        for channel, sign in channels:
            mix[i, channel] = sign / len(channels)
    for i in range(3):
        coefficients[:, RATE + i] = by_state(P + i, RATE_STEP_RPS)
    air = np.column_stack([by_state(U + i, SPEED_STEP_MPS) for i in range(3)])
    _express_by_force(coefficients, air)
    # The lateral force is left out: it depends on the sideslip and on no actuator.
    rows = [0, 1, 2, FORCE_X, FORCE_X, FORCE_Z]
    coefficients, air = coefficients[rows], air[rows]
    throttle = None
    if THROTTLE in names:
        number = names.index(THROTTLE)
        throttle = trimmed.throttle_counts(number, rows, coefficients[:, OUTPUT + number])
    powers, cruise_mps = np.zeros(TERMS), np.inf
    if coefficients[FORWARD, FORCE:].any():  # wings
        coefficients[FORWARD_BY_AIRSPEED, AIRSPEED], air[FORWARD_BY_AIRSPEED, 0] = (
            air[FORWARD, 0],
            0.0,
        )
        cruise_mps = vehicle.parameters.cruise_mps
        powers[CONSTANT] = 2.0
        powers[OUTPUT : OUTPUT + len(names)] = 2.0 * _surfaces(names)
        powers[RATE:FORCE] = 1.0
        air[:ANGULAR, 0] = 0.0  # the powers include it
    # Actuators are named by the vehicle kind, such as `motor 1` or `elevator`.
    known = mix, coefficients, air, lags_s, powers, cruise_mps
    return Effects(tuple(names[:COMMANDS]), *known, throttle=throttle)


def _surfaces(names: list[str]) -> Array:
    """Return 1 for each control surface and 0 for each motor (n,)."""
    motors = [name == THROTTLE or name.startswith("motor") for name in names]
    return np.array([0.0 if motor else 1.0 for motor in motors])


def _slope(motion: Callable[[Array], Array], size: int, entry: int, step: float) -> Array:
    """Return the central difference of `motion` with respect to one entry of (size,)."""
    change = np.zeros(size)
    change[entry] = step
    return (motion(change) - motion(-change)) / (2.0 * step)


def _express_by_force(coefficients: Array, air: Array) -> None:
    """Express the effect of the air by the lateral force; changes (6, TERMS), (6, 3) in place."""
    rows = slice(0, FORCE_Y)
    for i, axis in enumerate((FORCE_Y, FORCE_Z)):
        lateral_force = air[axis, i + 1]
        if abs(lateral_force) > MIN_WING_HZ:
            coefficients[rows, FORCE + i] = air[rows, i + 1] / lateral_force
    across = coefficients[rows, FORCE:AIRSPEED]
    forces = slice(FORCE_Y, BODY_AXES)
    # The force's term already contains the effects of commands and rates through the force.
    coefficients[rows, :FORCE] -= across @ coefficients[forces, :FORCE]
    air[rows] -= across @ air[forces]
