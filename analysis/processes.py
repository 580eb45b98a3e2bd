"""Processes of our own, with queues and locks between them."""

import sys
import threading
from multiprocessing import get_context
from multiprocessing.context import BaseContext, ForkContext, SpawnContext

from mavproxy_fault.documents.errors import ConfigError


def spawn_context() -> SpawnContext:
    """What makes them, each a fresh interpreter: a fork would copy threads' locks.

    Raises
    ------
    ConfigError
        If the system gives no semaphores; Linux keeps them in `/dev/shm`.
    """
    context = get_context("spawn")
    _check_semaphores(context)
    return context


def fork_context() -> ForkContext | None:
    """What makes copies of this one, with all modules at once; None where that is not sound.

    It would copy other threads' locks as they stand, and only Linux does it soundly.

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
            f"no processes besides this one: {error} (/dev/shm must exist and be writable)"
        ) from None
