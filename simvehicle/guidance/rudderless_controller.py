"""The plain autopilot for fixed wings without a rudder, which may lack yaw stiffness as well.

On such an airframe ailerons that hold the bank tightly against sideslip yaw the nose away until it
spins: only bank, rates and sideslip together can be held. So the aileron is a linear-quadratic
regulator of the lateral states about the steady turn that has the wanted bank (Bryson and Ho,
Applied Optimal Control, 1975, section 5.2), and guidance asks for gentle turns.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from simvehicle.guidance.fixedwing_controller import FixedWingController, WingMotion
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.trim import LATERAL, TrimPoint, linearise_trim

_AILERON = 1  # column of the input matrix
_ROLL = 1  # place of the roll angle among the lateral states v, roll, p, r
# Deviations that cost the same: sideslip [m/s], roll [rad], p, r [rad/s] against aileron [rad].
_EQUAL_COST = (5.0, 0.2, 3.0, 1.0)
_EQUAL_COST_AILERON = 0.1


class _Regulator(NamedTuple):
    """Gains (4,), and the steady turn (4,) and its aileron per radian of bank."""

    gains: NDArray[np.float64]
    turn: NDArray[np.float64]
    aileron: float


class RudderlessController(FixedWingController):
    """As `FixedWingController`, with slow turns and an aileron that minds sideslip and yaw."""

    lateral_mps2 = STANDARD_GRAVITY_MPS2 * math.tan(math.radians(12.0))
    course_gain = 0.35
    track_gain = 0.06
    bank_limit = math.radians(25.0)
    roll_lag_s = 2.0

    def __init__(self, vehicle: FixedWing, density: float, home_alt_m: float) -> None:
        super().__init__(vehicle, density, home_alt_m)
        self._regulators: dict[float, _Regulator] = {}

    def _aileron(self, point: TrimPoint, now: WingMotion, bank: float) -> float:
        """Deflection [rad] that brings the lateral states to those of the turn."""
        speed = point.airspeed_mps
        if speed not in self._regulators:
            self._regulators[speed] = self._regulator(point)
        gains, turn, aileron = self._regulators[speed]
        lateral = np.array([now.v, now.roll, now.p, now.r])
        weaker = (speed / now.airspeed) ** 2  # than at the trim
        return weaker * float(aileron * bank - gains @ (lateral - turn * bank))

    def _regulator(self, point: TrimPoint) -> _Regulator:
        from scipy.linalg import solve_continuous_are

        vehicle = self.vehicle
        a, b = linearise_trim(
            point, vehicle.body, vehicle.aero, self._density, STANDARD_GRAVITY_MPS2
        )
        a, b = a[np.ix_(LATERAL, LATERAL)], b[LATERAL, _AILERON : _AILERON + 1]
        weights = np.diag(1.0 / np.square(_EQUAL_COST))
        cost = solve_continuous_are(a, b, weights, [[1.0 / _EQUAL_COST_AILERON**2]])
        gains = (b.T @ cost)[0] * _EQUAL_COST_AILERON**2
        # Nothing changes in a steady turn: v, p, r and the aileron follow from the roll angle.
        fixed = np.column_stack([np.delete(a, _ROLL, axis=1), b])
        *rest, aileron = np.linalg.solve(fixed, -a[:, _ROLL])
        return _Regulator(gains, np.insert(np.array(rest), _ROLL, 1.0), float(aileron))


def has_rudder(vehicle: FixedWing) -> bool:
    """Whether the airframe's rudder does anything."""
    return vehicle.aero.crdr != 0.0 or vehicle.aero.cndr != 0.0
