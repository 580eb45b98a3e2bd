"""Processes that one of ours starts: they end with it, and how they ended is told."""

import ctypes
import os
import signal
from contextlib import suppress
from multiprocessing import parent_process

PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def die_with_parent() -> None:
    """Have the kernel end this process with its parent, which alone can end its waiting."""
    with suppress(AttributeError, TypeError):  # macOS and Windows have no such thing
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    parent = parent_process()
    if parent is not None and not parent.is_alive():  # before the kernel was asked
        os._exit(1)


def describe_exit(code: int) -> str:
    """How a program ended."""
    return f"with exit code {code}" if code >= 0 else f"by signal {-code}"
