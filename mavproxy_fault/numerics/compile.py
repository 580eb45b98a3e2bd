"""How this project compiles numerical functions with numba, with their types kept."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import config, njit

from mavproxy_fault.numerics.code_cache import folder

config.CACHE_DIR = str(folder())

# It takes half the time to compile, and plain loops and lanes run as fast. Fast mathematics is left
# out: fused multiply-add gains a fifth, but what it rounds depends on what was inlined where, and a
# first run, which compiles, would give other last bits than the runs after it.
config.OPT = type(config.OPT)(1)

# Without the entry points for C, which nobody calls: they take a seventh of the time to compile.
_OPTIONS = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True, "nogil": True}

Function = TypeVar("Function", bound=Callable[..., Any])


def constant(value: int) -> int:
    """A number for compiled calls: for each plain one numba compiles what is called anew."""
    return cast(int, np.int64(value))


def compiled(function: Function) -> Function:
    """Compile a function that Python calls; the machine code is kept on disk."""
    return cast(Function, njit(**_OPTIONS)(function))


def inlined(function: Function) -> Function:
    """Compile a function for compiled callers, always inlined, so that their loops vectorise."""
    return cast(Function, njit(**_OPTIONS, forceinline=True)(function))
