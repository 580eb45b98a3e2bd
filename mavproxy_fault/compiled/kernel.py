"""How the functions of the compiled form are compiled: each becomes part of its caller."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

# For type checkers a number of the compiled code is a number of Python.
i64 = cast(Callable[[Any], int], np.int64)

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Let compiled code call a function."""
    return cast(Function, njit(error_model="numpy", forceinline=True)(function))
