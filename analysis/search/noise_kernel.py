"""Gaussian noise for many trajectories at once, branch-free so that LLVM can vectorise it.

Each trajectory has its own generator, Marsaglia's xorshift with the shifts 13, 7, 17 [1]_, started
by SplitMix64 from the seed and the trajectory's number, so that its noise does not depend on which
others fly beside it. One 64-bit draw gives two uniform numbers of 32 bits and Box and Muller's
transform [2]_ two independent Gaussian ones, at most 6.7 sigma.

References
----------
.. [1] Marsaglia, Xorshift RNGs, Journal of Statistical Software 8(14), 2003.
.. [2] Box and Muller, Annals of Mathematical Statistics 29(2), 1958.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from simvehicle.compiled import inlined
from simvehicle.vehicles.polynomial import sin_cos

_intrinsic: Callable[[Any], Callable[[Any], Any]] = intrinsic


@_intrinsic
def bits_of(_context: Any, _x: Any) -> Any:
    """Reinterpret a float64 as a uint64."""

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], context.get_value_type(types.uint64))

    return types.uint64(types.float64), generate


@_intrinsic
def float_of(_context: Any, _i: Any) -> Any:
    """Reinterpret a uint64 as a float64."""

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], context.get_value_type(types.float64))

    return types.float64(types.uint64), generate


@inlined
def log(x: float) -> float:
    """Natural logarithm of a positive normal number; coefficients of Cephes' log.c."""
    bits = bits_of(x)
    mantissa = float_of((bits & np.uint64(0xFFFFFFFFFFFFF)) | np.uint64(0x3FE0000000000000))
    # the exponent as a float, by placing its bits under 2^52
    exponent = float_of((bits >> np.uint64(52)) | np.uint64(0x4330000000000000))
    exponent = exponent - (4503599627370496.0 + 1022.0)
    low = mantissa < 0.70710678118654752440
    exponent = exponent - 1.0 if low else exponent
    z = 2.0 * mantissa - 1.0 if low else mantissa - 1.0
    p = (1.01875663804580931796e-4 * z + 4.97494994976747001425e-1) * z + 4.70579119878881725854
    p = (p * z + 1.44989225341610930846e1) * z + 1.79368678507819816313e1
    p = p * z + 7.70838733755885391666
    q = (z + 1.12873587189167450590e1) * z + 4.52279145837532221105e1
    q = (q * z + 8.29875266912776603211e1) * z + 7.11544750618563894466e1
    q = q * z + 2.31251620126765340583e1
    square = z * z
    y = z * square * p / q - 2.121944400546905827679e-4 * exponent - 0.5 * square
    result: float = z + y + 0.693359375 * exponent
    return result


@inlined
def next_bits(s: np.uint64) -> np.uint64:
    """The generator's next state, which is also its output (uint64)."""
    s = s ^ (s << np.uint64(13))
    s = s ^ (s >> np.uint64(7))
    return s ^ (s << np.uint64(17))


@inlined
def gauss_pair(bits: np.uint64) -> tuple[float, float]:
    """Two independent standard Gaussian numbers from one draw of 64 bits."""
    one = np.uint64(0x3FF0000000000000)
    half = np.uint64(0x80000)  # the middle of the 2^-32 step: never 0
    high = float_of(((bits >> np.uint64(32)) << np.uint64(20)) | one | half) - 1.0
    low = float_of(((bits & np.uint64(0xFFFFFFFF)) << np.uint64(20)) | one | half) - 1.0
    radius = np.sqrt(-2.0 * log(high))
    sine, cosine = sin_cos(2.0 * math.pi * low)
    return radius * cosine, radius * sine


def generator_states(seed: int, numbers: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Start states (n,) of the generators with these numbers (n,), never 0.

    SplitMix64 (Steele, Lea and Flood, OOPSLA 2014) of the seed, then of the number.
    """
    start = _mixed(np.array([seed], dtype=np.uint64))
    return np.maximum(_mixed(start ^ numbers), np.uint64(1))


def _mixed(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    z = z + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
