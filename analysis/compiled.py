"""Compilation of the analysis' inner loops: numba, cached beside the source file."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numba

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """`function` as machine code; compiled at its first call and cached on disk."""
    result: Callable[P, R] = numba.njit(cache=True, error_model="numpy")(function)
    return result
