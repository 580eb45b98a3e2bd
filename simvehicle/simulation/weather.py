"""The wind of a flight: steady wind with shear, and gusts from their own random stream."""

from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from simvehicle.environment.air import GUST_LEVELS, STEADY_WIND, Gusts, step_wind
from simvehicle.scenario.scenario_file import Environment, GustChoice
from simvehicle.vehicles.body import Truth

Array = NDArray[np.float64]
# Drawn in blocks, as a call to numpy costs more than the five draws of a step.
DRAW_BLOCK = 512
_NO_SHEAR = (1.0, 0.0)


class Weather:
    """The wind, stepped together with the vehicle.

    Attributes
    ----------
    steady_mps : array, shape (3,)
        Wind at the shear's reference height, NED; plant faults write to it.
    filters, law, draws, row
        The inputs of `step_wind`, and the row of `draws` used by the last step.
    """

    def __init__(self, environment: Environment, seed: int) -> None:
        self._rng = np.random.default_rng([seed, crc32(b"gusts")])
        # The first-order filter starts stationary, the others at zero.
        self.filters = np.concatenate([self._rng.standard_normal(1), np.zeros(4)])
        self.draws = self._rng.standard_normal((DRAW_BLOCK, 5))
        self.row = 0
        gusts, shear = _gusts(environment), environment.shear
        law = (shear.reference_m, shear.exponent) if shear else _NO_SHEAR
        steady = environment.wind_ned_mps
        self.law = np.array([*gusts.sigma_mps, *gusts.length_m, *law, *steady])
        # A view: a plant fault that writes to it takes effect at the next step.
        self.steady_mps: Array = self.law[STEADY_WIND:]

    def wind(self, x: Array, truth: Truth, dt: float) -> Array:
        """Wind (3,) of the next `dt` seconds, NED [m/s], at the vehicle's state `x`."""
        self.row += 1
        if self.row == DRAW_BLOCK:
            self.draws, self.row = self._rng.standard_normal((DRAW_BLOCK, 5)), 0
        out = np.empty(3)
        step_wind(
            self.filters,
            self.draws[self.row],
            self.law,
            x,
            truth.v_air_b_mps,
            truth.height_agl_m,
            dt,
            out,
        )
        return out


def _gusts(environment: Environment) -> Gusts:
    choice = environment.gusts
    if isinstance(choice, GustChoice):
        return Gusts(choice.sigma_mps, choice.length_m)
    return GUST_LEVELS[choice]
