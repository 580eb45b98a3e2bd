"""The wind of a flight: steady wind with shear, and gusts from their own random stream."""

from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from simvehicle.environment.air import GUST_DRAWS, GUST_LEVELS, STEADY_WIND, Gusts
from simvehicle.scenario.scenario_file import Environment
from simvehicle.sensors.error_model import BLOCK

_NO_SHEAR = (1.0, 0.0)


class Weather:
    """The inputs of `step_wind` in a flight's record, and the random stream of its draws.

    Attributes
    ----------
    steady_mps : array, shape (3,)
        Wind at the shear's reference height, NED; plant faults write to it.
    """

    def __init__(self, environment: Environment, seed: int, flight: Any) -> None:
        self._rng = np.random.default_rng([seed, crc32(b"gusts")])
        self._flight = flight
        # The first-order filter starts stationary, the others at zero.
        flight["filters"][0] = self._rng.standard_normal()
        gusts, shear = environment.gusts, environment.shear
        gusts = gusts if isinstance(gusts, Gusts) else GUST_LEVELS[gusts]
        self._calm = not any(gusts.sigma_mps)  # draws then have no effect, and remain zero
        self._draw()
        law = (shear.reference_m, shear.exponent) if shear else _NO_SHEAR
        flight["weather"] = [*gusts.sigma_mps, *gusts.length_m, *law, *environment.wind_ned_mps]
        self.steady_mps: NDArray[np.float64] = flight["weather"][STEADY_WIND:]

    def refill(self) -> None:
        """Draw the next block of random numbers if the last one is used up."""
        if self._flight["row"] == BLOCK - 1:
            self._draw()
            self._flight["row"] = -1

    def _draw(self) -> None:
        if not self._calm:
            self._flight["draws"] = self._rng.standard_normal((BLOCK, GUST_DRAWS))
