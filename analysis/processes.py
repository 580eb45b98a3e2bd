"""Contexts for child processes, with queues and locks between them."""

import sys
import threading
from multiprocessing import get_context
from multiprocessing.context import BaseContext, ForkContext, SpawnContext

from mavproxy_fault.documents.errors import ConfigError


def spawn_context() -> SpawnContext:
    """Return the context whose children are fresh interpreters; a fork would copy held locks.

    Raises
    ------
    ConfigError
        If the system has no semaphores; Linux keeps them in `/dev/shm`.
    """
    context = get_context("spawn")
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
