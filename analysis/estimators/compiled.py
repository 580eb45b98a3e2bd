"""The one place that asks numba to compile an estimator's scalar kernels; cached on disk."""

from collections.abc import Callable
from typing import TypeVar

import numba

F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """`function` as machine code, without Python's checks for division by zero."""
    kernel: F = numba.njit(cache=True, error_model="numpy")(function)
    return kernel
