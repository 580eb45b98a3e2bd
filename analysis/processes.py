"""Processes of our own, each a fresh interpreter."""

from multiprocessing import get_context
from multiprocessing.context import SpawnContext

from mavproxy_fault.documents.errors import ConfigError


def spawning() -> SpawnContext:
    """What makes them, with queues and locks between them: a fork would copy threads' locks.

    Raises
    ------
    ConfigError
        If the system gives no semaphores; Linux keeps them in `/dev/shm`.
    """
    context = get_context("spawn")
    try:
        context.Lock()
    except (ImportError, OSError) as error:
        raise ConfigError(
            f"no processes besides this one: {error} (/dev/shm must exist and be writable)"
        ) from None
    return context
