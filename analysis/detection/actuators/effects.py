"""What is known beforehand of a vehicle's motion: a linear model about steady flight.

The axes are angular acceleration about x, y and z in rad/s^2 and specific force along x, along x
once more, and along z in m/s^2, body axes. On each of them the motion is a sum of terms: a
constant, the commands of the actuators, the rates in rad/s, and, for all but the last, the specific
force along y and z. That stands for the angles of the air, which nobody measures: what turns the
body or drags at it also pushes it. The second axis along x is told the airspeed in m/s, too, where
it is measured; what is wrong there alone is wrong with the pitot tube.
"""

from typing import NamedTuple

import numpy as np

from analysis.samples.sample import Vector

COMMANDS = 12  # outputs of an autopilot in a sample, and the most actuators of a vehicle
AXES, ANGULAR = 6, 3
FORWARD, FORWARD_BY_AIRSPEED, DOWN = range(ANGULAR, AXES)
# Where the terms begin in a row of coefficients; behind the last there are `TERMS`.
CONSTANT, OUTPUT, RATE = 0, 1, 1 + COMMANDS
FORCE = RATE + 3
AIRSPEED = FORCE + 2
TERMS = AIRSPEED + 1
CONSTANT_SIGMA = 30.0  # of an axis before the flight: the weight, and any trim
EFFECT_SIGMA_SHARE = 0.15  # one sigma of a coefficient, and of what is not linear in it
# One sigma of coefficients that are small or missing: a share of the greatest of their kind, and
# for rates 1/s, for forces rad/s^2 per m/s^2
SMALL_SHARE, SMALL_COMMAND, SMALL_RATE, SMALL_FORCE = 0.02, 0.02, 0.3, 0.02
# The same for a vehicle of which nothing is known, of any output
UNKNOWN_SIGMA, UNKNOWN_RATE_HZ, UNKNOWN_FORCE = 50.0, 1.0, 0.1
UNKNOWN_LIFT_MPS2 = 5.0  # of one of four rotors that hover at half their power
UNKNOWN_LAG_S = 0.04  # of motors
UNKNOWN_AIR_HZ = 0.1  # what moving air does to it, on any axis
GUST_MPS = 1.0  # one sigma of the air's own motion within a second
AUTHORITY_SHARE = 0.006  # of the strongest actuator's effect: what the model is wrong by anyhow


class Effects(NamedTuple):
    """What an autopilot's outputs do to a vehicle with the actuators `names`, n of them.

    `mix` (COMMANDS, COMMANDS) makes the actuators' commands of the outputs, its first n rows;
    `coefficients` are (AXES, TERMS), and `air` (AXES, 3) is what moving air does, per m/s. Of an
    unknown vehicle they are learnt, and its rotors alone are judged. `lags_s` (COMMANDS,) is how
    long each actuator takes; `powers` (TERMS,) of the airspeed over `cruise_mps` scale the terms of
    the angular axes.
    """

    names: tuple[str, ...]
    mix: Vector
    coefficients: Vector
    air: Vector
    lags_s: Vector
    powers: Vector
    cruise_mps: float
    unknown: bool = False

    def covariances(self) -> Vector:
        """Of the coefficients before the flight (AXES, TERMS, TERMS)."""
        if self.unknown:
            sigma = np.full((AXES, TERMS), UNKNOWN_RATE_HZ)
            sigma[:, CONSTANT] = CONSTANT_SIGMA
            sigma[:ANGULAR, FORCE:AIRSPEED] = UNKNOWN_FORCE
            sigma[ANGULAR:, FORCE:] = sigma[:, AIRSPEED:] = 0.0
            # Rotors lift and turn, and push nowhere else.
            sigma[:ANGULAR, OUTPUT:RATE] = UNKNOWN_SIGMA
            sigma[DOWN, OUTPUT:RATE] = UNKNOWN_LIFT_MPS2 / 2.0
            return np.array([np.diag(row**2) for row in sigma])
        sigma = EFFECT_SIGMA_SHARE * np.abs(self.coefficients)
        kinds = ((OUTPUT, RATE, SMALL_COMMAND), (RATE, FORCE, SMALL_RATE))
        for begin, end, least in (*kinds, (FORCE, AIRSPEED, SMALL_FORCE)):
            greatest = np.abs(self.coefficients[:, begin:end]).max(axis=1, keepdims=True)
            sigma[:, begin:end] = np.hypot(
                sigma[:, begin:end], np.maximum(SMALL_SHARE * greatest, least)
            )
        sigma[:, CONSTANT] = CONSTANT_SIGMA
        # What drags at a vehicle without wings is not told by what pushes it, nor by the airspeed.
        sigma[ANGULAR:, FORCE:] *= self.coefficients[ANGULAR:, FORCE:] != 0.0
        return np.array([np.diag(row**2) for row in sigma])

    def disturbance(self) -> Vector:
        """Covariance (AXES, AXES) of what gusts and the model's error do within a second."""
        authority = np.abs(self.coefficients[:, OUTPUT:RATE]).max(axis=1)
        # Axis by axis: which way a gust blows is known, how the axes go together is not.
        gusts = GUST_MPS**2 * (self.air**2).sum(axis=1)
        return np.diag(gusts + (AUTHORITY_SHARE * authority) ** 2)


def unknown_effects() -> Effects:
    """Of a vehicle of which nothing is known: every output may be a motor, by its number."""
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
