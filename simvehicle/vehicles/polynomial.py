"""Elementary functions as branch-free polynomials, so that LLVM can vectorise loops that use them.

Numba ships no vector mathematics library: a call of `math.sin` inside a loop keeps LLVM from
turning the loop into SIMD code. These forms use arithmetic, comparisons that become selects, and
bit patterns only. The coefficients are those of the Cephes library (S. Moshier, Methods and
Programs for Mathematical Functions, 1989: sin.c, exp.c, atan.c); errors stay below 1e-15.
"""

import math
from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic

from simvehicle.compiled import inlined

_ROUND = 6755399441055744.0  # 1.5 * 2^52: adding it leaves the nearest integer in the low bits
_HALF_PI_HEAD = 2.0 * 7.85398125648498535156e-1
_HALF_PI_MIDDLE = 2.0 * 3.77489470793079817668e-8
_HALF_PI_TAIL = 2.0 * 2.69515142907905952645e-15
_TINY = 1e-300
_intrinsic: Callable[[Any], Callable[[Any], Any]] = intrinsic


@_intrinsic
def _bits(_context: Any, _x: Any) -> Any:
    """Reinterpret a float64 as an int64."""

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], context.get_value_type(types.int64))

    return types.int64(types.float64), generate


@_intrinsic
def _float(_context: Any, _i: Any) -> Any:
    """Reinterpret an int64 as a float64."""

    def generate(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], context.get_value_type(types.float64))

    return types.float64(types.int64), generate


@inlined
def sin_cos(x: float) -> tuple[float, float]:
    """Sine and cosine of an angle in radians; |x| up to about 1e5."""
    shifted = x * (2.0 / math.pi) + _ROUND
    k = shifted - _ROUND
    quadrant = _bits(shifted)
    r = ((x - k * _HALF_PI_HEAD) - k * _HALF_PI_MIDDLE) - k * _HALF_PI_TAIL
    z = r * r
    s = 1.58962301576546568060e-10 * z - 2.50507477628578072866e-8
    s = (s * z + 2.75573136213857245213e-6) * z - 1.98412698295895385996e-4
    s = (s * z + 8.33333333332211858878e-3) * z - 1.66666666666666307295e-1
    s = r + r * z * s
    c = -1.13585365213876817300e-11 * z + 2.08757008419747316778e-9
    c = (c * z - 2.75573141792967388112e-7) * z + 2.48015872888517045348e-5
    c = (c * z - 1.38888888888730564116e-3) * z + 4.16666666666665929218e-2
    c = 1.0 - 0.5 * z + z * z * c
    swap = (quadrant & 1) != 0
    sine = c if swap else s
    cosine = s if swap else c
    sine = -sine if (quadrant & 2) != 0 else sine
    cosine = -cosine if ((quadrant + 1) & 2) != 0 else cosine
    return sine, cosine


@inlined
def exp(x: float) -> float:
    """Exponential for |x| < 700."""
    shifted = x * 1.4426950408889634073599 + _ROUND
    k = shifted - _ROUND
    r = x - k * 6.93145751953125e-1 - k * 1.42860682030941723212e-6
    z = r * r
    p = (1.26177193074810590878e-4 * z + 3.02994407707441961300e-2) * z + 9.99999999999999999910e-1
    p = r * p
    q = (3.00198505138664455042e-6 * z + 2.52448340349684104192e-3) * z + 2.27265548208155028766e-1
    q = q * z + 2.00000000000000000009
    power: float = _float((_bits(shifted) + 1023) << 52)
    return (1.0 + 2.0 * p / (q - p)) * power


@inlined
def atan2(y: float, x: float) -> float:
    """Angle of the point (x, y) in (-pi, pi]; zero at the origin."""
    ax = abs(x)
    ay = abs(y)
    steep = ay > ax
    small = ax if steep else ay
    large = (ay if steep else ax) + _TINY
    middle = small > 0.41421356237309504880 * large  # beyond pi/8: turn by pi/4
    numerator = small - large if middle else small
    denominator = small + large if middle else large
    t = numerator / denominator
    z = t * t
    p = -8.750608600031904122785e-1 * z - 1.615753718733365076637e1
    p = (p * z - 7.500855792314704667340e1) * z - 1.228866684490136173410e2
    p = p * z - 6.485021904942025371773e1
    q = (z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2
    q = (q * z + 4.328810604912902668951e2) * z + 4.853903996359136964868e2
    q = q * z + 1.945506571482613964425e2
    angle = t + t * z * p / q
    angle = angle + 0.25 * math.pi if middle else angle
    angle = 0.5 * math.pi - angle if steep else angle
    angle = math.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle
