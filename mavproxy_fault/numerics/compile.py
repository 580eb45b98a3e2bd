"""How this project compiles numerical functions with numba, with their types kept.

numba's level of optimisation and its cache folder are settings of the whole process. A library must
not set those, since they also hold for other people's functions. So each function of ours has its
own cache, and the level is set only while one of ours is being compiled, under numba's lock.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import config, njit
from numba.core import caching
from numba.core.compiler_lock import global_compiler_lock

from mavproxy_fault.numerics.code_cache import folder

# Level 1 takes half the time to compile, and plain loops and lanes run as fast. Fast mathematics is
# left out: fused multiply-add gains a fifth, but what it rounds depends on what was inlined where,
# and a first run, which compiles, would give other last bits than the runs after it.
LEVEL = type(config.OPT)(1)

# Without the entry points for C, which nobody calls: they take a seventh of the time to compile.
_OPTIONS = {"error_model": "numpy", "no_cfunc_wrapper": True}

Function = TypeVar("Function", bound=Callable[..., Any])


class _Locator(caching._CacheLocator):  # type: ignore[misc]  # numba has no types
    """Keeps the machine code of one function in our folder, which is named after all sources."""

    def __init__(self, function: Callable[..., Any], source: str) -> None:
        self._path = folder()
        self._source = source
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Callable[..., Any], source: str) -> "_Locator":
        """The locator; unlike numba's own it finds a place for every function."""
        return cls(function, source)

    def get_cache_path(self) -> str:
        """The folder of the function's file."""
        return str(self._path / self.get_suitable_cache_subpath(self._source))

    def get_source_stamp(self) -> str:
        """One stamp for all, as the folder's name changes with any source."""
        return self._path.name

    def get_disambiguator(self) -> str:
        """Tells functions of one name in one file apart."""
        return str(self._line)


class _CacheImpl(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class _Cache(caching.FunctionCache):  # type: ignore[misc]
    _impl_class = _CacheImpl


def _jitted(function: Function, **options: bool) -> Function:
    """A dispatcher with our cache, which compiles at our level."""
    dispatcher: Any = njit(**_OPTIONS, **options)(function)
    dispatcher._cache = _Cache(function)
    compile_one = dispatcher._compiler.compile

    def compile_at_level(*args: Any) -> Any:
        with global_compiler_lock:  # another thread's functions keep their own level
            before, config.OPT = config.OPT, LEVEL
            try:
                return compile_one(*args)
            finally:
                config.OPT = before

    dispatcher._compiler.compile = compile_at_level
    return cast(Function, dispatcher)


def constant(value: int) -> int:
    """A number for compiled calls: for each plain one numba compiles what is called anew."""
    return cast(int, np.int64(value))


def compiled(function: Function) -> Function:
    """Compile a function that Python calls; the machine code is kept on disk."""
    return _jitted(function)


def inlined(function: Function) -> Function:
    """Compile a function for compiled callers, always inlined, so that their loops vectorise."""
    return _jitted(function, forceinline=True)
