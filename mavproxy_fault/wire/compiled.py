"""The three ways this project compiles numerical functions with numba, with their types kept."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import config, njit

from mavproxy_fault.wire.kernels import folder

config.CACHE_DIR = str(folder())

# It takes half the time to compile, and plain loops and lanes run as fast. One level for all, since
# the last bits of results depend on it, and machine code that one command made serves the others.
config.OPT = type(config.OPT)(1)

# Fused multiply-add, one reciprocal for several divisions by one number, signless zeros: a quarter
# faster, differences in the last bit only. Not allowed: reordering, or ignoring NaN and infinity.
_FAST = {"contract", "arcp", "nsz"}

# Without the entry points for C, which nobody calls: they take a seventh of the time to compile.
_OPTIONS = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function that Python calls; the machine code is kept on disk."""
    return cast(Function, njit(**_OPTIONS, fastmath=_FAST)(function))


def exact(function: Function) -> Function:
    """Compile a function that must round as Python does."""
    return cast(Function, njit(**_OPTIONS)(function))


def inlined(function: Function) -> Function:
    """Compile a function for compiled callers, always inlined, so that their loops vectorise."""
    return cast(Function, njit(**_OPTIONS, fastmath=_FAST, forceinline=True)(function))
