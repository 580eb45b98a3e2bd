"""The built-in controller of fixed wings without a rudder, which may lack yaw stiffness, too.

On such an airframe a tight bank control by ailerons alone diverges in yaw until the aircraft spins,
so bank, rates and sideslip are controlled together: the aileron is a linear-quadratic regulator of
the lateral states about the steady turn at the bank setpoint (Bryson and Ho, Applied Optimal
Control, 1975, section 5.2). Guidance is limited to gentle turns.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from simvehicle.guidance.fixedwing_controller import FixedWingController, WingMotion
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.trim import LATERAL, TrimPoint, linearise_trim
from simvehicle.vehicles.solution import round_solution

_AILERON = 1  # column of the input matrix
_ROLL = 1  # index of the roll angle in the lateral states v, roll, p, r
# Bryson's rule: deviations of equal cost in sideslip [m/s], roll [rad], p, r [rad/s] and aileron.
_EQUAL_COST = (5.0, 0.2, 3.0, 1.0)
_EQUAL_COST_AILERON = 0.1


class _Regulator(NamedTuple):
    """Gains (4,); lateral states (4,) and aileron of the steady turn, per radian of bank."""

    gains: NDArray[np.float64]
    turn: NDArray[np.float64]
    aileron: float


class RudderlessController(FixedWingController):
    """A `FixedWingController` with gentle turns and an aileron that controls sideslip and yaw."""

    lateral_mps2 = STANDARD_GRAVITY_MPS2 * math.tan(math.radians(12.0))
    course_gain = 0.35
    track_gain = 0.06
    bank_limit = math.radians(25.0)
    roll_lag_s = 2.0

    def __init__(self, vehicle: FixedWing, density: float, home_alt_m: float) -> None:
        super().__init__(vehicle, density, home_alt_m)
        self._regulators: dict[float, _Regulator] = {}

    def _aileron(self, point: TrimPoint, motion: WingMotion, bank: float) -> float:
        """Deflection [rad] that regulates the lateral states to those of the steady turn."""
        speed = point.airspeed_mps
        if speed not in self._regulators:
            self._regulators[speed] = self._regulator(point)
        gains, turn, aileron = self._regulators[speed]
        lateral = np.array([motion.v, motion.roll, motion.p, motion.r])
        scale = (speed / motion.airspeed) ** 2  # of the dynamic pressure, relative to the trim
        return scale * float(aileron * bank - (gains * (lateral - turn * bank)).sum())

    def _regulator(self, point: TrimPoint) -> _Regulator:
        vehicle = self.vehicle
        a, b = linearise_trim(
            point, vehicle.body, vehicle.aero, self._density, STANDARD_GRAVITY_MPS2
        )
        a, b = a[np.ix_(LATERAL, LATERAL)], b[LATERAL, _AILERON : _AILERON + 1]
        weights = np.diag(1.0 / np.square(_EQUAL_COST))
        control = b @ b.T * _EQUAL_COST_AILERON**2
        # The Riccati equation's solution spans the stable half of the Hamiltonian's eigenvectors.
        values, vectors = np.linalg.eig(np.block([[a, -control], [-weights, -a.T]]))
        upper, lower = np.split(vectors[:, values.real < 0.0], 2)
        cost = np.real(lower @ np.linalg.inv(upper))
        gains = (b.T @ cost)[0] * _EQUAL_COST_AILERON**2
        # In a steady turn v, p, r and the aileron follow from the roll angle.
        fixed = np.column_stack([np.delete(a, _ROLL, axis=1), b])
        *rest, aileron = np.linalg.solve(fixed, -a[:, _ROLL])
        turn = np.insert(np.array(rest), _ROLL, 1.0)
        gains, turn, aileron = map(round_solution, (gains, turn, aileron))
        return _Regulator(gains, turn, float(aileron))


def has_rudder(vehicle: FixedWing) -> bool:
    """Whether the rudder of the airframe has an effect."""
    return vehicle.aero.crdr != 0.0 or vehicle.aero.cndr != 0.0
