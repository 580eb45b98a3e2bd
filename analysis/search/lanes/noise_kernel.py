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

from mavproxy_fault.numerics.compile import inlined
from mavproxy_fault.numerics.polynomial import fma, sin_cos

GENERATORS = 4  # streams of noise of each flight
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
    """Natural logarithm of a positive normal number to 3e-10, which does for noise.

    A minimax polynomial about 1, without the division that ones for all digits need.
    """
    bits = bits_of(x)
    mantissa = float_of((bits & np.uint64(0xFFFFFFFFFFFFF)) | np.uint64(0x3FE0000000000000))
    # the exponent as a float, by placing its bits under 2^52
    exponent = float_of((bits >> np.uint64(52)) | np.uint64(0x4330000000000000))
    exponent = exponent - (4503599627370496.0 + 1022.0)
    low = mantissa < 0.70710678118654752440
    exponent = exponent - 1.0 if low else exponent
    z = 2.0 * mantissa - 1.0 if low else mantissa - 1.0
    y = z * z
    even = fma(1.0703173868773347194e-1, y, 1.1005971106776227843e-1)
    even = fma(fma(even, y, 1.4288390892955720858e-1), y, 1.9999974485378308111e-1)
    even = fma(even, y, 3.3333333387667396773e-1)
    odd = fma(-6.5185159937650039792e-2, y, -1.0598790046870771327e-1)
    odd = fma(fma(odd, y, -1.2452770668107651628e-1), y, -1.6667978351387716496e-1)
    odd = fma(odd, y, -2.499999030373073921e-1)
    small = fma(y * z, fma(z, odd, even), fma(-0.5, y, z))
    result: float = fma(0.69314718055994530942, exponent, small)
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


def streams(seed: int, numbers: NDArray[np.int64]) -> NDArray[np.uint64]:
    """The generators (GENERATORS, n) of flights with these numbers (n,)."""
    first = np.uint64(GENERATORS) * numbers.astype(np.uint64)
    return np.stack([generator_states(seed, first + np.uint64(i)) for i in range(GENERATORS)])


def seed_of(seed: int, number: int) -> int:
    """The simulator's seed of a flight."""
    return int(generator_states(seed, np.array([number], dtype=np.uint64))[0] >> np.uint64(33))


def _mixed(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    z = z + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
