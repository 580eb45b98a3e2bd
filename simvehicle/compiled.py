"""The two ways this package compiles numerical functions with numba, with their types kept."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function that Python calls; the machine code is cached beside its file."""
    return cast(Function, njit(cache=True, error_model="numpy")(function))


def inlined(function: Function) -> Function:
    """Compile a function for compiled callers, always inlined, so that their loops vectorise."""
    return cast(Function, njit(cache=True, error_model="numpy", forceinline=True)(function))
