"""Spoofed signals: those of another position and time, as a spoofer sends them to the antenna.

Code and Doppler are those of a receiver at the spoofed position, so they are consistent with each
other, with the ephemerides and with the position that the receiver computes.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.earth import curvature_radii
from mavproxy_fault.wire.plant_names import FASTEST_SPOOF_MPS

DELAY = 3  # the row of `SignalFaults.spoof` after the position


class SpoofedPlace(NamedTuple):
    """One spoofed position and time: `offset_m` (4,) is north, east, down and delay [m],
    `offset_mps` (4,) their rate [m/s], `mask` (n,) that of the spoofed satellites."""

    offset_m: Array
    offset_mps: Array
    mask: NDArray[np.bool_]

    def position(self, here: Array) -> Array:
        """The spoofed latitude, longitude [rad], height [m] and velocity NED (6,)."""
        meridian_m, prime_m = curvature_radii(here[0])
        north_m, east_m, down_m = self.offset_m[:DELAY].tolist()
        spoofed = here.copy()
        spoofed[0] += north_m / (float(meridian_m) + here[2])
        spoofed[1] += east_m / ((float(prime_m) + here[2]) * np.cos(here[0]))
        spoofed[2] -= down_m
        spoofed[3:] += self.offset_mps[:DELAY]
        return spoofed


def spoofed_places(spoof: Array, before: Array, step_s: float) -> Iterator[SpoofedPlace]:
    """Yield each distinct spoofed position with its satellites.

    Parameters
    ----------
    spoof, before : (4, n) arrays
        `SignalFaults.spoof` of this epoch and the last.
    step_s : float
        Time since then; 0 at the first epoch.
    """
    # Satellites spoofed to the same position share one computation.
    for change in np.unique(spoof[:, spoof.any(axis=0)], axis=1).T:
        satellites = (spoof == change[:, None]).all(axis=0)
        moved = (change - before[:, satellites][:, 0]) / step_s if step_s > 0.0 else 0.0 * change
        # A position jump is not motion: it shows in the code only, not in the Doppler.
        rate = np.where(np.abs(moved) <= FASTEST_SPOOF_MPS, moved, 0.0)
        yield SpoofedPlace(change, rate, satellites)
