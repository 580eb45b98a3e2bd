"""Child processes: they end with their parent, and their exit is described."""

import ctypes
import os
import signal
from contextlib import suppress
from multiprocessing import parent_process

PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def die_with_parent() -> None:
    """Have the kernel kill this process when its parent ends."""
    with suppress(AttributeError, TypeError):  # macOS and Windows lack prctl
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    parent = parent_process()
    if parent is not None and not parent.is_alive():  # it ended before prctl
        os._exit(1)


def describe_exit(code: int) -> str:
    """Describe how a process ended."""
    return f"with exit code {code}" if code >= 0 else f"by signal {-code}"
