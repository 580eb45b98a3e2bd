"""The wind of a flight: steady, with shear, and gusts from a stream of their own."""

from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from simvehicle.environment.air import GUSTS, STEADY, Gusts, wind_step
from simvehicle.scenario.scenario_file import Environment, GustChoice
from simvehicle.vehicles.body import Truth

Array = NDArray[np.float64]
# Drawn many at once: a call to numpy costs more than the five numbers of a step.
_BLOCK = 512
_NO_SHEAR = (1.0, 0.0)


class Weather:
    """Goes on step by step with the vehicle.

    Attributes
    ----------
    steady_mps : array, shape (3,)
        Wind at the shear's reference height, NED; plant faults write to it.
    """

    def __init__(self, environment: Environment, seed: int) -> None:
        self._rng = np.random.default_rng([seed, crc32(b"gusts")])
        # The first filter is of first order and begins stationary; the others begin calm.
        self._filters = np.concatenate([self._rng.standard_normal(1), np.zeros(4)])
        self._draws = self._rng.standard_normal((_BLOCK, 5))
        self._row = 0
        gusts, shear = _gusts(environment), environment.shear
        law = (shear.reference_m, shear.exponent) if shear else _NO_SHEAR
        steady = environment.wind_ned_mps
        self._law = np.array([*gusts.sigma_mps, *gusts.length_m, *law, *steady])
        # A view, no copy: what a plant fault writes here is in force at the next step.
        self.steady_mps: Array = self._law[STEADY:]

    def wind(self, x: Array, truth: Truth, dt: float) -> Array:
        """Wind (3,) of the next `dt` seconds, NED [m/s], at the vehicle's state `x`."""
        self._row += 1
        if self._row == _BLOCK:
            self._draws, self._row = self._rng.standard_normal((_BLOCK, 5)), 0
        out = np.empty(3)
        wind_step(
            self._filters,
            self._draws[self._row],
            self._law,
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
    return GUSTS[choice]
