"""How this project compiles numerical functions with numba, with their types kept.

numba's level of optimisation and its cache folder are settings of the whole process. A library must
not set those, since they also hold for other people's functions. So each function of ours has its
own cache, and the level is set only while one of ours is being compiled, under numba's lock.
"""

import logging
import math
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial
from glob import escape, iglob
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numba import config, njit
from numba.core import caching
from numba.core.compiler_lock import global_compiler_lock
from numba.core.types import Dispatcher

from mavproxy_fault.documents.atomic_file import write_atomic
from mavproxy_fault.numerics.baseline import BASELINE
from mavproxy_fault.numerics.code_cache import IDLE_S, PROGRESS, alone, kernels, module_folders

LOG = logging.getLogger(__name__)

# Level 1 takes half the time to compile, and plain loops run as fast. Fast mathematics is
# left out: fused multiply-add gains a fifth, but what it rounds depends on what was inlined where,
# and a first run, which compiles, would give other last bits than the runs after it.
LEVEL = type(config.OPT)(1)

# Without the entry points for C, which are unused: they take a seventh of the time to compile.
_OPTIONS = {"error_model": "numpy", "no_cfunc_wrapper": True}

REPORT_PERIOD_S = 2.0  # most functions take less: no silence of more than 5 s

Function = TypeVar("Function", bound=Callable[..., Any])


class _Locator(caching._CacheLocator):  # type: ignore[misc]  # numba has no types
    """One folder, which is named after the sources: their stamp is always the same."""

    def __init__(self, folder: Path, source: str) -> None:
        self._folder, self._py_file = folder, source  # numba names the source in a warning

    def from_function(self, function: Callable[..., Any], source: str) -> "_Locator":
        """This locator, where numba asks a class for one."""
        return self

    def get_cache_path(self) -> str:
        """The folder of the function's files."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Nothing, and no disambiguator: numba's index distinguishes functions by their code."""
        return ""

    get_disambiguator = get_source_stamp


class _CodeFiles(caching.CompileResultCacheImpl):  # type: ignore[misc]
    def __init__(self, folder: Path, function: Callable[..., Any]) -> None:
        self._locator_classes = (_Locator(folder, function.__code__.co_filename),)
        super().__init__(function)


class _Cache(caching.FunctionCache):  # type: ignore[misc]
    """Machine code of one function in one folder; unreadable code counts as absent.

    What was installed is code for the baseline, which any later processor finds by that name.
    """

    def __init__(self, function: Callable[..., Any], folder: Path, installed: bool) -> None:
        self._impl_class = partial(_CodeFiles, folder)
        super().__init__(function)
        self._installed = installed
        self.lock = folder / f"{self._impl.filename_base}.lock"

    def holds(self, signature: Any, codegen: Any) -> bool:
        """Whether there is code for these types of arguments."""
        with suppress(OSError):
            return self._index_key(signature, codegen) in self._cache_file._load_index()
        return False

    def _index_key(self, signature: Any, codegen: Any) -> Any:
        signature, (triple, *processor), code = super()._index_key(signature, codegen)
        return signature, (triple, *((BASELINE, "") if self._installed else processor)), code

    def _load_overload(self, signature: Any, context: Any) -> Any:
        with suppress(OSError):
            return super()._load_overload(signature, context)
        return None

    def _save_overload(self, signature: Any, code: Any) -> None:
        # A function among the arguments is another one in each process, which could not find it.
        if any(isinstance(argument, Dispatcher) for argument in code.signature.args):
            return
        with suppress(OSError):  # it serves this process, and the next one makes it again
            super()._save_overload(signature, code)


def _announce(name: str) -> None:
    """Report progress, one line for all processes that compile at the same time."""
    shared = kernels() / PROGRESS
    now_s = time.time()
    with suppress(OSError):  # nowhere to write to: each process reports for itself
        kernels().mkdir(parents=True, exist_ok=True)
        silent_s = now_s - shared.stat().st_mtime if shared.exists() else math.inf
        if silent_s < REPORT_PERIOD_S:
            return
        if silent_s > IDLE_S:  # the last compilation was that of another command
            write_atomic(shared, repr(now_s))
        os.utime(shared)
        begun_s = float(shared.read_text())
        done = 0
        for path in iglob(f"{escape(str(kernels()))}/*/*.nbc"):
            with suppress(FileNotFoundError):  # another process has removed an outdated one
                done += os.path.getmtime(path) > begun_s
        LOG.warning(
            "compiling kernels (first use only): %d done, %.0f s, %s", done, now_s - begun_s, name
        )
        return
    _announce_once()


@cache
def _announce_once() -> None:
    LOG.warning(
        "compiling kernels; no cache folder can be written to, so the next start compiles again"
    )


@contextmanager
def _at_our_level() -> Iterator[None]:
    with global_compiler_lock:  # another thread's functions keep their own level
        before, config.OPT = config.OPT, LEVEL
        try:
            yield
        finally:
            config.OPT = before


def _jitted(function: Function, **options: bool) -> Function:
    """A dispatcher with our cache, which compiles at our level."""
    dispatcher: Any = njit(**_OPTIONS, **options)(function)
    module, source = function.__module__, Path(function.__code__.co_filename)
    caches = [_Cache(function, *folder) for folder in module_folders(module, source)]
    compile_one = dispatcher.compile

    def load_or_compile(signature: Any) -> Any:
        with ExitStack() as stack:
            stack.enter_context(_at_our_level())
            if signature not in dispatcher.overloads:
                codegen = dispatcher.targetctx.codegen()
                held = next((one for one in caches if one.holds(signature, codegen)), None)
                dispatcher._cache = held or caches[0]
                if held is None:
                    # A process that waited here loads the code that the other process compiled.
                    _announce(f"{module}.{function.__name__}")
                    stack.enter_context(alone(caches[0].lock))
            return compile_one(signature)

    dispatcher.compile = load_or_compile
    return cast(Function, dispatcher)


def constant(value: int) -> int:
    """A number for compiled calls: numba compiles the callee anew for each literal int."""
    return cast(int, np.int64(value))


def compiled(function: Function) -> Function:
    """Compile a function that Python calls; the machine code is kept on disk."""
    return _jitted(function)


def unlocked(function: Function) -> Function:
    """Compile a function that waits: other threads of Python run meanwhile."""
    return _jitted(function, nogil=True)


def inlined(function: Function) -> Function:
    """Compile a function for compiled callers, always inlined."""
    return _jitted(function, forceinline=True)
