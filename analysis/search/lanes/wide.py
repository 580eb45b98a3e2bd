"""Leave for LLVM to use 512-bit registers.

On processors with AVX-512 LLVM prefers 256-bit registers, since wide ones slow the clock of some;
kernels that do nothing but arithmetic on 32 lanes gain about half as much speed again from the
wide ones. Other processors take no notice.
"""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import intrinsic

_intrinsic: Callable[[Any], Callable[[], None]] = intrinsic


@_intrinsic
def wide(_context: Any) -> Any:
    """Mark the function that calls this for 512-bit vectors."""

    def generate(context: Any, builder: Any, _signature: Any, _args: Any) -> Any:
        # llvmlite checks names against a list that has no string attributes
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.none(), generate
