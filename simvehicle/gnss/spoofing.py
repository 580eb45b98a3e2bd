"""Signals made up for another place and time, as a spoofer sends them to the antenna.

Code and Doppler are those which a receiver at the pretended place would get, so that they agree
with each other, with the ephemerides and with every position that the receiver computes.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.earth import curvature_radii
from mavproxy_fault.wire.plant_names import FASTEST_SPOOF_MPS

Vector = NDArray[np.float64]

NORTH, DOWN, DELAY = slice(0, 2), 2, 3  # rows of `Faults.spoof`


class SpoofedPlace(NamedTuple):
    """One pretended place and time: `offset_m` (4,) is north, east, down and delay [m],
    `offset_mps` (4,) how fast they change [m/s], `satellites` (n,) whose signals are made up for
    it."""

    offset_m: Vector
    offset_mps: Vector
    satellites: NDArray[np.bool_]

    @property
    def delay_m(self) -> float:
        """What every range is longer by."""
        return float(self.offset_m[DELAY])

    @property
    def delay_mps(self) -> float:
        """How fast the delay grows."""
        return float(self.offset_mps[DELAY])

    def spoofed_position(self, here: Vector) -> Vector:
        """The pretended latitude, longitude [rad], height [m] and velocity NED (6,)."""
        meridian_m, prime_m = curvature_radii(here[0])
        north_m, east_m, down_m = self.offset_m[:DELAY].tolist()
        there = here.copy()
        there[0] += north_m / (float(meridian_m) + here[2])
        there[1] += east_m / ((float(prime_m) + here[2]) * np.cos(here[0]))
        there[2] -= down_m
        there[3:] += self.offset_mps[:DELAY]
        return there


def spoofed_places(spoof: Vector, before: Vector, step_s: float) -> Iterator[SpoofedPlace]:
    """Each place that is pretended to some satellites.

    Parameters
    ----------
    spoof, before : (4, n) arrays
        `Faults.spoof` now and at the last epoch.
    step_s : float
        Time since then; 0 at the first epoch.
    """
    # Satellites that pretend the same place share one computation of it.
    for change in np.unique(spoof[:, spoof.any(axis=0)], axis=1).T:
        satellites = (spoof == change[:, None]).all(axis=0)
        moved = (change - before[:, satellites][:, 0]) / step_s if step_s > 0.0 else 0.0 * change
        # A leap is no motion: it shows in the code alone, not in the Doppler.
        rate = np.where(np.abs(moved) <= FASTEST_SPOOF_MPS, moved, 0.0)
        yield SpoofedPlace(change, rate, satellites)
