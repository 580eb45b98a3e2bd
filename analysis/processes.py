"""Contexts for child processes, with queues and locks between them."""

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from multiprocessing import get_context
from multiprocessing.context import BaseContext, ForkContext, SpawnContext, SpawnProcess
from typing import Any

from mavproxy_fault.documents.errors import ConfigError

SAFE_PATH = "PYTHONSAFEPATH"  # of Python: as its option -P


@contextlib.contextmanager
def _safe_path() -> Iterator[None]:
    """Let interpreters that start now leave the working directory, and its `types.py`, alone."""
    if SAFE_PATH in os.environ:
        yield
        return
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        del os.environ[SAFE_PATH]


class FreshProcess(SpawnProcess):
    """A child that finds the modules that its parent finds, whatever its folder holds."""

    def __init__(self, *args: Any, **keys: Any) -> None:
        super().__init__(*args, **keys)
        self._removes = SAFE_PATH not in os.environ

    @staticmethod
    def _Popen(process_obj: Any) -> Any:
        with _safe_path():
            return SpawnProcess._Popen(process_obj)

    def run(self) -> None:
        """Run the task; programs that it starts find their own modules as usual."""
        if self._removes:
            del os.environ[SAFE_PATH]
        super().run()


class FreshContext(SpawnContext):
    """The spawn context with `FreshProcess`."""

    Process = FreshProcess


def spawn_context() -> SpawnContext:
    """Return the context whose children are fresh interpreters; a fork would copy held locks.

    Raises
    ------
    ConfigError
        If the system has no semaphores; Linux keeps them in `/dev/shm`.
    """
    context = FreshContext()
    with _safe_path():  # the first lock starts a process that tracks them
        _check_semaphores(context)
    return context


def fork_context() -> ForkContext | None:
    """Return the context whose children are forks, with all modules loaded; None where unsafe.

    A fork copies the locks that other threads hold, and is safe on Linux only.

    Raises
    ------
    ConfigError
        As `spawn_context` does.
    """
    if sys.platform != "linux" or threading.active_count() > 1:
        return None
    context = get_context("fork")
    _check_semaphores(context)
    return context


def _check_semaphores(context: BaseContext) -> None:
    try:
        context.Lock()
    except (ImportError, OSError) as error:
        raise ConfigError(
            f"cannot start child processes: {error}; make sure that /dev/shm exists and is writable"
        ) from None
