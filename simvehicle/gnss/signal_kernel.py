"""The signals at an antenna in one epoch, with all errors: one compiled loop over satellites."""

from collections.abc import Callable
from math import sin
from typing import NamedTuple, cast

import numpy as np
from numba.np.unsafe.ndarray import to_fixed_tuple

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.compile import compiled, inlined
from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.earth_kernel import ecef_of, ned_axes
from mavproxy_fault.numerics.signal_noise import code_sigma_m, rate_sigma_mps
from simvehicle.gnss.pseudorange import (
    DELAY,
    RANGE,
    RANGE_RATE,
    SAT_CLOCK,
    SAT_CLOCK_RATE,
    SAT_ELEVATION,
    signal_geometry,
)
from simvehicle.gnss.signal_errors import multipath_sigma_m

_Scalar = Callable[[float], float]
_code_sigma = cast(_Scalar, inlined(code_sigma_m))
_rate_sigma = cast(_Scalar, inlined(rate_sigma_mps))
_multipath_sigma = cast(_Scalar, inlined(multipath_sigma_m))

# Entries of `levels`
CN0_HORIZON, CN0_RISE, CN0_SIGMA, THERMAL, MULTIPATH, ORBIT, GALILEO = range(7)
ELEVATION, CN0, CODE, RATE = range(4)  # rows of the result
RANGE_ADDED, CN0_DROP, _, RATE_ADDED = range(4)  # rows of the faults, in the order of `SATELLITE`


class SignalChannel(NamedTuple):
    """The propagation model between satellites and receiver, constant over a flight.

    `coefficients` and `troposphere` as for `signal_geometry`, `levels` (7,) the error sizes by
    the names above, `galileo` (n,) is 1 for Galileo satellites.
    """

    coefficients: Array
    troposphere: bool
    levels: Array
    galileo: Array


@compiled
def simulate_signals(
    table: Array,
    tow_s: float,
    where: Array,
    clock: tuple[float, float],
    channel: SignalChannel,
    wander: Array,
    faults: Array,
    noise: Array,
) -> Array:
    """Elevation [rad], C/N0 [dBHz], pseudorange [m] and range rate [m/s] of n satellites (4, n).

    Parameters
    ----------
    table : (n, 20) array
        Orbits.
    tow_s : float
        Time on the receiver's clock, in seconds of the orbits' week.
    where : (6,) array
        The antenna's latitude, longitude [rad], height [m] and velocity NED [m/s] at `tow_s`.
    clock : 2 floats
        The receiver's clock offset [s] and drift.
    wander : (3, n) array
        Unit-variance processes of multipath, orbit and C/N0.
    faults : (4, n) array
        `SignalFaults.signals`, whose rows are in the order of `SATELLITE`.
    noise : (2, n) array
        Standard-normal draws of range and rate.
    """
    offset_s, drift = clock
    lat, lon, height, north, east, down = to_fixed_tuple(where, 6)
    axes = ned_axes(lat, lon)
    place, motion = np.empty(3), np.empty(3)
    place[0], place[1], place[2] = ecef_of(lat, lon, height)
    for i in range(3):
        motion[i] = axes[0, i] * north + axes[1, i] * east + axes[2, i] * down
        # The receiver samples on its own clock, so it moves by the offset until then.
        place[i] -= motion[i] * offset_s
    levels = channel.levels
    geometry = signal_geometry(
        table, tow_s - offset_s, place, motion, channel.coefficients, channel.troposphere
    )
    out = np.empty((4, len(table)))
    for k in range(len(table)):
        elevation = geometry[SAT_ELEVATION, k]
        # Antenna gain falls towards the horizon, roughly with the sine of the elevation.
        cn0 = levels[CN0_HORIZON] + levels[CN0_RISE] * sin(elevation)
        cn0 += levels[CN0_SIGMA] * wander[2, k] - faults[CN0_DROP, k]
        code = geometry[RANGE, k] + SPEED_OF_LIGHT_MPS * (offset_s - geometry[SAT_CLOCK, k])
        code += geometry[DELAY, k]
        # The inter-system bias is common to all Galileo satellites: the receiver estimates it.
        code += levels[GALILEO] * channel.galileo[k] + faults[RANGE_ADDED, k]
        code += levels[ORBIT] * wander[1, k]
        # The process has unit variance: scale it to the elevation.
        code += levels[MULTIPATH] * _multipath_sigma(elevation) * wander[0, k]
        code += levels[THERMAL] * _code_sigma(cn0) * noise[0, k]
        rate = geometry[RANGE_RATE, k] + SPEED_OF_LIGHT_MPS * (drift - geometry[SAT_CLOCK_RATE, k])
        rate += faults[RATE_ADDED, k] + levels[THERMAL] * _rate_sigma(cn0) * noise[1, k]
        out[ELEVATION, k], out[CN0, k], out[CODE, k], out[RATE, k] = elevation, cn0, code, rate
    return out
