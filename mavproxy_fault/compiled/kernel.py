"""How the functions of the compiled form are compiled: each becomes part of its caller."""

import types
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

# For type checkers a number of the compiled code is a number of Python.
i64 = cast(Callable[[Any], int], np.int64)

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Let compiled code call a function."""
    return cast(Function, njit(error_model="numpy", forceinline=True)(function))


@cache
def kernel_of(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a plain function of another module, and those that it calls."""
    inner = {
        name: kernel_of(value)
        for name in function.__code__.co_names
        if isinstance(value := function.__globals__.get(name), types.FunctionType)
    }
    return kernel(types.FunctionType(function.__code__, {**function.__globals__, **inner}))


def choose(functions: Sequence[Callable[..., Any]], arguments: str) -> Callable[..., float]:
    """Compile a function that calls one of several by its number, its first argument."""
    names: dict[str, Any] = {f"f{n}": kernel_of(one) for n, one in enumerate(functions)}
    lines = [f"    if n == {n}: return float(f{n}({arguments}))" for n in range(len(functions))]
    # numba cannot call a function out of a list.
    exec("\n".join([f"def chosen(n, {arguments}):", *lines, "    return 0.0"]), names)
    return kernel(cast("Callable[..., float]", names["chosen"]))
