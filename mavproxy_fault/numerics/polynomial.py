"""Exponential and angle as polynomials, with the same bits whatever mathematics library there is.

Cephes' exp.c and atan.c (S. Moshier, Methods and Programs for Mathematical Functions, 1989) divide
two polynomials; a longer polynomial is faster: those here are minimax fits (Lawson's reweighting in
40 digits). Errors are below 1e-15.
"""

import math
from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic

from mavproxy_fault.numerics.compile import inlined

_ROUND = 6755399441055744.0  # 1.5 * 2^52: adding and subtracting it leaves the nearest integer
_TINY = 1e-300  # avoids 0 / 0 in the angle of the origin
_intrinsic: Callable[[Any], Callable[..., Any]] = intrinsic


@_intrinsic
def fma(_context: Any, _a: Any, _b: Any, _c: Any) -> Any:
    """Return a * b + c, rounded once: faster polynomials with the same bits wherever they are
    inlined, which LLVM's automatic contraction does not guarantee."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.fma(*args)

    f8 = types.float64
    return f8(f8, f8, f8), generate


@inlined
def exp(x: float) -> float:
    """Return the exponential, |x| < 700."""
    k = x * 1.4426950408889634073599 + _ROUND - _ROUND
    r = x - k * 6.93145751953125e-1 - k * 1.42860682030941723212e-6
    z = r * r
    # two independent chains, of even and odd powers, run in parallel
    even = fma(2.7620062488319502291e-7, z, 2.4801521354428684041e-5)
    even = fma(fma(even, z, 1.3888888917172766157e-3), z, 4.1666666666624219037e-2)
    even = fma(even, z, 5.000000000000001019e-1)
    odd = fma(2.5108784815228029737e-8, z, 2.7557245762879120345e-6)
    odd = fma(fma(odd, z, 1.9841269883495880177e-4), z, 8.3333333333232438988e-3)
    odd = fma(odd, z, 1.6666666666666673591e-1)
    result: float = (1.0 + fma(z, fma(r, odd, even), r)) * math.ldexp(1.0, int(k))
    return result


@inlined
def atan2(y: float, x: float) -> float:
    """Return the angle of the point (x, y) in (-pi, pi]; zero at the origin."""
    ax = abs(x)
    ay = abs(y)
    steep = ay > ax
    small = ax if steep else ay
    large = (ay if steep else ax) + _TINY
    middle = small > 0.41421356237309504880 * large  # beyond pi/8: rotate by pi/4
    numerator = small - large if middle else small
    denominator = small + large if middle else large
    t = numerator / denominator
    z = t * t
    y2 = z * z  # two independent chains
    even = fma(-1.9224032802665330409e-2, y2, -5.0869019974783451099e-2)
    even = fma(fma(even, y2, -6.6645465124563498738e-2), y2, -9.0909046966065577224e-2)
    even = fma(fma(even, y2, -1.4285714284706852364e-1), y2, -3.3333333333333330327e-1)
    odd = fma(3.9271812881001827514e-2, y2, 5.858439394783655776e-2)
    odd = fma(fma(odd, y2, 7.6921858061281478793e-2), y2, 1.1111111018329931596e-1)
    odd = fma(odd, y2, 1.9999999999995724314e-1)
    angle: float = fma(t * z, fma(z, odd, even), t)
    angle = angle + 0.25 * math.pi if middle else angle
    angle = 0.5 * math.pi - angle if steep else angle
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle
