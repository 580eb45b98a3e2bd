"""The prior model of a vehicle's motion, linear about steady flight (docs/fdi.md, "Actuators").

The axes are angular acceleration about x, y and z in rad/s^2, and specific force along x, again
along x, and along z in m/s^2, body axes. An error on the second axis along x alone, which also has
the airspeed, is the pitot tube's.
"""

from typing import NamedTuple

import numpy as np

from analysis.samples.sample import Vector

THROTTLE = "throttle"
COMMANDS = 12  # outputs of an autopilot in a sample, and the most actuators of a vehicle
AXES, ANGULAR = 6, 3  # all, and those that turn
FORWARD, FORWARD_BY_AIRSPEED, DOWN = range(ANGULAR, AXES)
# First column of each kind of term in a row of coefficients; `TERMS` in all.
CONSTANT, OUTPUT, RATE, FORCE = 0, 1, 1 + COMMANDS, 4 + COMMANDS
AIRSPEED, TERMS = 6 + COMMANDS, 7 + COMMANDS  # the last
CONSTANT_SIGMA = 30.0  # of an axis before the flight: three times the weight, for any trim
# On flights of benchmarks/actuator_watch.py, seed 1. One sigma of a coefficient and of its
# nonlinearity: half or twice changes delays by 0.2 s.
EFFECT_SIGMA_SHARE = 0.15
# Smallest sigma, else a coefficient of 0 could not be learned; rates in 1/s, forces in rad/m.
SMALL_COMMAND, SMALL_RATE, SMALL_FORCE = 0.02, 0.3, 0.02
# The same for any output of an unknown vehicle: the examples' have 38 to 67, 0.3 to 0.8 and 0.
UNKNOWN_SIGMA, UNKNOWN_RATE_HZ, UNKNOWN_FORCE = 50.0, 1.0, 0.1
UNKNOWN_LIFT_MPS2 = 5.0  # one of four rotors that hover at half power
UNKNOWN_LAG_S = 0.04  # a typical motor
UNKNOWN_AIR_HZ = 0.1  # response to moving air, on any axis
GUST_MPS = 1.0  # one sigma of the wind's change in 1 s, moderate gusts of simvehicle
AUTHORITY_SHARE = 0.006  # of the strongest effect: twice finds a stuck rudder 10 s later


class Effects(NamedTuple):
    """What an autopilot's outputs do to a vehicle with the n actuators `names`.

    `mix` (COMMANDS, COMMANDS) converts outputs to the actuators' commands, its first n rows;
    `coefficients` are (AXES, TERMS), and `air` (AXES, 3) is the response to moving air per m/s.
    Those of an unknown vehicle are learned, and only its rotors are tested. `lags_s` (COMMANDS,)
    are the actuators' time constants; `powers` (TERMS,) of the airspeed over `cruise_mps` scale the
    terms of the angular axes. `throttle` (AXES, n) is what a throttle's command counts in the
    linear model, for n even steps from 0 to 1: a propeller's effect grows with its square.
    """

    names: tuple[str, ...]
    mix: Vector
    coefficients: Vector
    air: Vector
    lags_s: Vector
    powers: Vector
    cruise_mps: float
    unknown: bool = False
    throttle: Vector | None = None

    def covariances(self) -> Vector:
        """Covariances of the coefficients before the flight (AXES, TERMS, TERMS)."""
        if self.unknown:
            sigma = np.full((AXES, TERMS), UNKNOWN_RATE_HZ)
            sigma[:, CONSTANT] = CONSTANT_SIGMA
            sigma[:ANGULAR, FORCE:AIRSPEED] = UNKNOWN_FORCE
            sigma[ANGULAR:, FORCE:] = sigma[:, AIRSPEED:] = 0.0
            # Rotors lift and turn the body; they have no other force.
            sigma[:ANGULAR, OUTPUT:RATE] = UNKNOWN_SIGMA
            sigma[DOWN, OUTPUT:RATE] = UNKNOWN_LIFT_MPS2 / 2.0
            return np.array([np.diag(row**2) for row in sigma])
        sigma = EFFECT_SIGMA_SHARE * np.abs(self.coefficients)
        kinds = ((OUTPUT, RATE, SMALL_COMMAND), (RATE, FORCE, SMALL_RATE))
        for begin, end, least in (*kinds, (FORCE, AIRSPEED, SMALL_FORCE)):
            sigma[:, begin:end] = np.hypot(sigma[:, begin:end], least)
        sigma[:, CONSTANT] = CONSTANT_SIGMA
        # Without wings neither side force nor airspeed predicts drag.
        sigma[ANGULAR:, FORCE:] *= self.coefficients[ANGULAR:, FORCE:] != 0.0
        return np.array([np.diag(row**2) for row in sigma])

    def disturbance(self) -> Vector:
        """Covariance (AXES, AXES) of gusts and model error within a second."""
        authority = np.abs(self.coefficients[:, OUTPUT:RATE]).max(axis=1)
        # Diagonal: the axes' correlation in a gust is unknown.
        gusts = GUST_MPS**2 * (self.air**2).sum(axis=1)
        return np.diag(gusts + (AUTHORITY_SHARE * authority) ** 2)


def unknown_effects() -> Effects:
    """Effects of an unknown vehicle: every output may be a motor, named by its number."""
    coefficients = np.zeros((AXES, TERMS))
    coefficients[DOWN, OUTPUT:RATE] = -UNKNOWN_LIFT_MPS2
    return Effects(
        tuple(f"motor {i + 1}" for i in range(COMMANDS)),
        np.eye(COMMANDS),
        coefficients,
        np.full((AXES, 3), UNKNOWN_AIR_HZ),
        np.full(COMMANDS, UNKNOWN_LAG_S),
        np.zeros(TERMS),
        np.inf,
        unknown=True,
    )
